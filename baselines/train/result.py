"""The result of a training: a network with its card, or the best weights of one that diverged."""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

from baselines.tae.checkpoint import Checkpoint, load_checkpoint
from baselines.train.config import TrainingConfig
from baselines.train.state import state_path
from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError, RunMismatchError
from rema_data.loader.release import Release
from rema_data.validation import validated

__all__ = ["DIVERGED", "NAME", "DivergedError", "Trained", "check_network_name", "trained"]

DIVERGED = "diverged"
"""Folder, below that of the networks, of what was kept of trainings that failed: no policy takes it for a network."""
NAME = r"[a-z0-9][a-z0-9_-]*"
"""How a network may be called."""


class DivergedError(RemaError, ArithmeticError):
    """The loss, or the network itself, is not a number any more."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained network, and whether it was there before."""

    folder: Path
    name: str
    checkpoint: Checkpoint
    already: bool


def check_network_name(name: str) -> None:
    """Raise an InputError where files of that name would not be found again, or lie elsewhere."""
    if not re.fullmatch(NAME, name):
        raise InputError(f"{name!r} cannot name a network", hint="use small letters, digits, - and _", name=name)


def trained(release: Release, config: TrainingConfig, folder: Path, name: str) -> Trained | None:
    """The finished training of this configuration and data in ``folder``, if it is there; its state is removed.

    Raises RunMismatchError for a network of another configuration or other data, IntegrityError for a damaged one.
    """
    if not (folder / f"{name}.json").exists():
        return None
    try:
        _, about = load_checkpoint(folder / name)
    except (IntegrityError, InputError, MissingFileError) as error:
        files = " ".join(shlex.quote(str(folder / f"{name}{end}")) for end in (".json", ".safetensors"))
        hint = f"delete it to train it again: rm -f {files}; or choose another --output or --name"
        raise type(error)(error.message, hint=hint, path=str(folder / name)) from error
    if about.release_sha256 != release.fingerprint or _configured(about, folder / name) != config:
        raise RunMismatchError(
            f"{folder / name} is a network of another training (release {about.release}, {about.updates:,} updates)",
            hint="choose another --output or --name",
            path=str(folder / name),
        )
    shutil.rmtree(state_path(folder, name), ignore_errors=True)
    return Trained(folder, name, about, already=True)


def _configured(about: Checkpoint, path: Path) -> TrainingConfig:
    """The configuration on a card; a card of an earlier version lacks the newest fields, which have a default."""
    return validated(TrainingConfig, about.training, f"{path}.json", hint="choose another --output or --name")
