"""Which file and class a policy reference means, and which weights it loads. Nothing is imported here."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from evaluator.policy.named import NamedPolicy, find_named, is_reserved, listing
from evaluator.policy.shipped import shipped_checkpoint
from rema_data.errors import InputError, MissingFileError

if TYPE_CHECKING:
    from evaluator.policy.sandbox.private_copy import PrivateCopy

__all__ = ["NAME_LENGTH", "PolicySpec", "check_checkpoint", "resolve", "weights_of"]

_DEFAULT_CLASS = "Policy"
NAME_LENGTH = 80
"""Most characters of a policy's name."""


@dataclass(frozen=True, slots=True)
class PolicySpec:
    """Where a policy's code is."""

    name: str  # shown in tables and used in folder names
    path: Path  # the Python file, absolute
    class_name: str
    named: NamedPolicy | None = None  # what its package says of it; None for a file
    # what runs in its place, for as long as it is held; None: a new copy for every host
    copy: PrivateCopy | None = field(default=None, compare=False, repr=False)


def resolve(reference: str) -> PolicySpec:
    """The file and class behind ``my_policy.py``, ``my_policy.py:ClassName`` or an installed policy's name.

    Raises MissingFileError without the file, InputError for an unknown policy or a bad class name.
    """
    named = find_named(reference)
    if named is not None:
        return PolicySpec(reference, named.file, named.class_name, named)
    file_name, class_name = _split(reference)
    path = Path(os.path.expanduser(file_name))
    if path.suffix != ".py":
        near = f"{file_name}.py"
        hint = f"write {near}" if Path(near).is_file() else f"give a .py file, or an installed policy:\n{listing()}"
        raise InputError(f"no policy is called {reference!r}", hint=hint, reference=reference)
    if not path.is_file():
        raise MissingFileError(f"policy file {path} does not exist", hint="check the path", path=path)
    stem = re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)
    name = stem if class_name == _DEFAULT_CLASS else f"{stem}-{class_name}"
    if is_reserved(stem) or is_reserved(name):
        name = name.replace(stem, f"{stem}.py", 1)  # a submitted random.py must not pass for the built-in
    if len(name) > NAME_LENGTH:
        raise InputError(
            f"the policy's name {name!r} has {len(name)} characters, more than {NAME_LENGTH}",
            hint="give its file or its class a shorter name",
            reference=reference,
        )
    return PolicySpec(name, path.resolve(), class_name)


def _split(reference: str) -> tuple[str, str]:
    """File and class of a reference; a colon inside a path (a drive letter) is not a class."""
    head, colon, tail = reference.rpartition(":")
    if not colon or "/" in tail or "\\" in tail:
        return reference, _DEFAULT_CLASS
    if not tail.isidentifier():
        raise InputError(f"{tail!r} is not a class name", hint="write my_policy.py:ClassName", reference=reference)
    return head, tail


def check_checkpoint(checkpoint: Path | None) -> Path | None:
    """The checkpoint as an absolute path under the name that it was given, or a MissingFileError."""
    if checkpoint is None:
        return None
    path = Path(os.path.expanduser(checkpoint))
    if not path.exists():
        raise MissingFileError(f"checkpoint {path} does not exist", hint="check the path after --checkpoint", path=path)
    return Path(os.path.abspath(path))


def weights_of(spec: PolicySpec, checkpoint: Path | None, task: str | None = None) -> Path | None:
    """The weights with which a policy is to play a task: those that the user names, else those that come with it.

    Without a task, those of a policy that come with it are the ones that play most tasks.

    Raises MissingFileError or IntegrityError where they are not there, or not the published ones.
    """
    if checkpoint is not None or spec.named is None:
        return check_checkpoint(checkpoint)
    return check_checkpoint(spec.named.checkpoint) or shipped_checkpoint(spec.name, task)
