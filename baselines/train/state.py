"""The state of a training between two runs: weights, optimiser, draws and history, so that a kill costs minutes.

Two files, safetensors and JSON, written one after the other under names that hold the update; the newest pair whose
hashes agree counts, and the one before it is kept until then.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from rema_data.errors import InputError, RunMismatchError
from rema_data.json_files import checked_digest, read_json, with_digest
from rema_data.locks import Busy, lock
from rema_data.storage import storage_errors, write_atomic
from rema_data.validation import plain, record, validated

__all__ = ["TrainingState", "locked", "read_state", "state_path", "write_state"]


class TrainingState(NamedTuple):
    """A training after ``update`` updates."""

    update: int
    tensors: Mapping[str, Tensor]  # ``model/``, ``exp_avg/``, ``exp_avg_sq/``, ``best/`` and ``generator``
    facts: dict[str, Any]  # sampler state, history and the best measures, ready for JSON


def state_path(folder: Path, name: str) -> Path:
    """Where the state of the training of ``folder / name`` lies."""
    return folder / f".{name}.training"


@record
class _Card:
    """The JSON file of a state."""

    identity: dict[str, Any]
    update: int
    sha256: str
    facts: dict[str, Any]


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock the folder of a training, created where it is missing; InputError says which process works there."""
    owner = folder / "owner.txt"
    with ExitStack() as stack:
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            try:
                stack.enter_context(lock(folder / ".lock", hint="choose a folder on a local disk with --output"))
            except Busy as error:
                user = owner.read_text(encoding="utf-8") if owner.is_file() else "another process"
                raise InputError(
                    f"{user} is working on this training: {folder}",
                    hint="wait for it, or choose another --output or --name",
                    path=str(folder),
                ) from error
        write_atomic(owner, f"process {os.getpid()} on {socket.gethostname()}")
        yield


def write_state(folder: Path, identity: Mapping[str, Any], state: TrainingState) -> None:
    """Make a state durable, then remove older ones; after a StorageError the state before this one is still there."""
    data = save({key: tensor.contiguous() for key, tensor in state.tensors.items()})
    card = _Card(dict(identity), state.update, hashlib.sha256(data).hexdigest(), state.facts)
    stem = f"state-{state.update:08d}"
    write_atomic(folder / f"{stem}.safetensors", data)
    write_atomic(folder / f"{stem}.json", json.dumps(with_digest(plain(card))) + "\n")
    with storage_errors(folder):
        for path in folder.glob("state-*"):
            if path.stem != stem:
                path.unlink(missing_ok=True)


def read_state(folder: Path, identity: Mapping[str, Any]) -> TrainingState | None:
    """The newest whole state in a folder, or None; RunMismatchError where it belongs to another training."""
    for path in sorted(folder.glob("state-*.json"), reverse=True):
        try:
            card = validated(_Card, checked_digest(read_json(path)), str(path))
            data = path.with_suffix(".safetensors").read_bytes()
        except (OSError, ValueError):
            continue
        if hashlib.sha256(data).hexdigest() != card.sha256:
            continue
        if card.identity != identity:
            names = sorted(key for key in {*identity, *card.identity} if identity.get(key) != card.identity.get(key))
            raise RunMismatchError(
                f"{folder} holds another training: {', '.join(names)} differ",
                hint=f"choose another --output, or delete {folder} to begin again",
                path=str(folder),
                differences=names,
            )
        try:
            return TrainingState(card.update, load(data), card.facts)
        except (SafetensorError, KeyError):
            continue
    return None
