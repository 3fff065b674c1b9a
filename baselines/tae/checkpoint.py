"""Checkpoints: ``NAME.safetensors`` holds the weights of one network, ``NAME.json`` says what it is. Never a pickle.

A policy is a folder of networks, each for some skills (the last step of a task: see ``rema_data.schema.skill``)::

    joint/     grasp.safetensors  grasp.json     skills: grasp, grasp_grasp
               push.safetensors   push.json      skills: push, grasp_push
    separate/  grasp, grasp_grasp, push, grasp_push, each for the skill of its name

The JSON names the sha256 of the weights, the architecture, the data (release and its sha256) and what validation said.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import pydantic
import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from baselines.tae.network import Architecture, TaeNetwork
from evaluator.policy.load_errors import conversion_command
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.json_files import bounded_file, checked_digest, read_json, with_digest
from rema_data.storage import storage_errors, write_atomic
from rema_data.validation import validated

__all__ = ["FORMAT", "Checkpoint", "load_checkpoint", "networks_in", "save_checkpoint"]

FORMAT = "rema tae checkpoint 1"
WEIGHTS, CARD = ".safetensors", ".json"
_AGAIN = "restore it (git checkout -- releases), fetch it again, or train it: rema train --help"
_MOST_BYTES = 1 << 30
_DTYPES = {"float32": torch.float32, "float16": torch.float16}


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a network is, beside its weights.

    Attributes
    ----------
    primitive : str
        ``grasp`` or ``push``.
    skills : tuple of str
        What it was trained on.
    architecture : Architecture
    release, release_sha256 : str
        The data.
    training : dict
        Configuration of the training.
    metrics : dict
        What validation said of these weights.
    updates : int
        Steps of the optimiser before these weights.
    commit : str
        Of the repository, or empty.
    sha256 : str
        Of the file of weights; filled in by ``save_checkpoint``.
    dtype : str
        How the weights are stored: ``float32`` or ``float16``.
    """

    primitive: str
    skills: tuple[str, ...]
    architecture: Architecture
    release: str
    release_sha256: str
    training: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    updates: int = 0
    commit: str = ""
    sha256: str = ""
    dtype: str = "float32"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {"format": FORMAT, **asdict(self), "skills": list(self.skills)}


def save_checkpoint(folder: Path, name: str, weights: Mapping[str, Tensor], about: Checkpoint) -> Checkpoint:
    """Write both files of a network, the card last; what was there under the name is replaced.

    Returns
    -------
    Checkpoint
        ``about`` with the sha256 of the weights.

    Raises
    ------
    StorageError
        The disk is full or may not be written.
    """
    kept = {key: _stored(tensor, about.dtype) for key, tensor in sorted(weights.items())}
    data = save(kept, {"format": FORMAT})
    done = Checkpoint(**{**_values(about), "sha256": hashlib.sha256(data).hexdigest()})
    write_atomic(folder / f"{name}{WEIGHTS}", data)
    write_atomic(folder / f"{name}{CARD}", json.dumps(with_digest(done.to_dict()), indent=1) + "\n")
    return done


def load_checkpoint(path: Path) -> tuple[TaeNetwork, Checkpoint]:
    """A network in evaluation mode, float32, with what is known of it.

    Parameters
    ----------
    path : Path
        ``NAME.safetensors``, or ``NAME.json``, or ``NAME``.

    Raises
    ------
    MissingFileError
        One of both files is not there.
    IntegrityError
        The weights are truncated, damaged, or not those that the card names.
    InputError
        It is a pickle, or a checkpoint of another program, another format or another architecture.
    """
    if path.suffix in (".pt", ".pth", ".ckpt", ".pkl", ".bin"):
        raise InputError(
            f"{path} is a pickle, which can run any code when it is opened",
            hint=f"convert its weights, and write a card as rema train does: {conversion_command(path)}",
            path=str(path),
        )
    stem = path.with_suffix("") if path.suffix in (WEIGHTS, CARD) else path
    about = _read_card(stem.with_name(stem.name + CARD))
    file = stem.with_name(stem.name + WEIGHTS)
    with storage_errors(file):
        try:
            data = bounded_file(file, _MOST_BYTES)
        except FileNotFoundError:
            raise MissingFileError(f"there are no weights at {file}", hint=_AGAIN, path=str(file)) from None
        except ValueError as error:
            raise IntegrityError(f"{file} cannot be the weights of a network: {error}", hint=_AGAIN) from error
    found = hashlib.sha256(data).hexdigest()
    if found != about.sha256:
        raise IntegrityError(
            f"{file} is truncated, damaged or of another training: its sha256 is {found[:12]}..., "
            f"its card names {about.sha256[:12]}...",
            hint=_AGAIN,
            path=str(file),
            expected=about.sha256,
            found=found,
        )
    network = TaeNetwork(about.architecture)
    try:
        weights = {key: tensor.to(_like(network, key)) for key, tensor in load(data).items()}
        network.load_state_dict(weights)
    except (SafetensorError, RuntimeError, KeyError, AttributeError) as error:
        raise InputError(
            f"{file} holds the weights of another architecture: {str(error).splitlines()[0]}",
            hint="train it with this version of rema: rema train",
            path=str(file),
        ) from error
    return network.eval(), about


def networks_in(path: Path) -> dict[str, Path]:
    """Names and files of the networks of a policy: a folder of them, or one network alone.

    Raises
    ------
    MissingFileError
        There is none.
    """
    files = sorted(path.glob(f"*{WEIGHTS}")) if path.is_dir() else [path]
    found = {file.stem: file for file in files}
    if not found:
        raise MissingFileError(f"there is no checkpoint in {path}", hint=_AGAIN, path=str(path))
    return found


def _read_card(path: Path) -> Checkpoint:
    with storage_errors(path):
        try:
            content = read_json(path)
        except FileNotFoundError:
            raise MissingFileError(
                f"there is no {path.name} beside the weights in {path.parent}", hint=_AGAIN, path=str(path)
            ) from None
        except ValueError as error:
            raise IntegrityError(f"{path} is not JSON: {error}", hint=_AGAIN, path=str(path)) from error
    try:
        content = checked_digest(content)
    except ValueError as error:
        raise IntegrityError(f"{path} is damaged: {error}", hint=_AGAIN, path=str(path)) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(
            f"{path} does not describe a {FORMAT!r}", hint="name a checkpoint that rema train wrote", path=str(path)
        )
    names = {item.name for item in fields(Checkpoint)}
    values = {key: value for key, value in content.items() if key != "format"}
    if set(values) != names:
        raise InputError(
            f"{path} has other fields than {FORMAT!r}: {', '.join(sorted(set(values) ^ names))}",
            hint="install the version of rema that made it",
            path=str(path),
        )
    validated(_Card, values, str(path), hint=_AGAIN)
    try:
        architecture = Architecture.from_dict(values["architecture"])
    except InputError as error:
        raise InputError(f"{path}: {error.message}", hint=error.hint, path=str(path)) from error
    return Checkpoint(**{**values, "skills": tuple(values["skills"]), "architecture": architecture})


@pydantic.with_config(pydantic.ConfigDict(extra="forbid", strict=True))
class _Card(TypedDict):
    """The fields of a card but for its format."""

    primitive: Literal["grasp", "push"]
    skills: list[str]
    architecture: dict[str, Any]
    release: str
    release_sha256: str
    training: dict[str, Any]
    metrics: dict[str, Any]
    updates: pydantic.NonNegativeInt
    commit: str
    sha256: str
    dtype: Literal["float32", "float16"]


def _values(about: Checkpoint) -> dict[str, Any]:
    return {item.name: getattr(about, item.name) for item in fields(about)}


def _stored(tensor: Tensor, dtype: str) -> Tensor:
    plain = tensor.detach().cpu().contiguous()
    return plain.to(_DTYPES[dtype]) if plain.is_floating_point() else plain


def _like(network: TaeNetwork, key: str) -> torch.dtype:
    return network.get_buffer(key).dtype if key.endswith("num_batches_tracked") else torch.float32
