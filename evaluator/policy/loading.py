"""Which file and class a policy reference means, and the digest of what will run. Nothing is imported here."""

from __future__ import annotations

import hashlib
import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path

from evaluator.policy.imports import own_modules
from rema_data.errors import InputError, MissingFileError

__all__ = ["BUILT_INS", "NAME_LENGTH", "OWN_PREFIX", "PolicySpec", "check_checkpoint", "digest", "resolve"]

BUILT_INS: dict[str, str] = {
    "random": "random_policy.py:RandomPolicy",
    "scripted": "scripted_policy.py:ScriptedPolicy",
    "reference": "reference_policy.py:ReferencePolicy",
    "tae": "tae_policy.py:TaePolicy",
    "tae-joint": "tae_policy.py:TaePolicy",
    "tae-separate": "tae_policy.py:TaePolicy",
}
"""Built-in names: file of the installed ``baselines`` package, and class."""

OWN_PREFIX = "tae-"
"""Names that begin like this are those of the learned baselines."""
_DEFAULT_CLASS = "Policy"
NAME_LENGTH = 80
"""Most characters of a policy's name."""


@dataclass(frozen=True, slots=True)
class PolicySpec:
    """Where a policy's code is.

    Attributes
    ----------
    name : str
        Shown in tables and used in folder names.
    path : Path
        The Python file, absolute.
    class_name : str
    """

    name: str
    path: Path
    class_name: str


def resolve(reference: str) -> PolicySpec:
    """The file and class behind ``my_policy.py``, ``my_policy.py:ClassName`` or a built-in name.

    Raises
    ------
    MissingFileError
        When the file is not there.
    InputError
        When the name is no built-in, or what follows the colon is no class name.
    """
    if reference in BUILT_INS:
        file_name, _, class_name = BUILT_INS[reference].partition(":")
        return PolicySpec(reference, _baselines_folder() / file_name, class_name)
    file_name, class_name = _split(reference)
    path = Path(file_name).expanduser()
    if path.suffix != ".py":
        near = f"{file_name}.py"
        hint = (
            f"write {near}"
            if Path(near).is_file()
            else f"built-in policies: {', '.join(BUILT_INS)}; or give a .py file"
        )
        raise InputError(f"no policy is called {reference!r}", hint=hint, reference=reference)
    if not path.is_file():
        raise MissingFileError(f"policy file {path} does not exist", hint="check the path", path=path)
    stem = re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)
    name = stem if class_name == _DEFAULT_CLASS else f"{stem}-{class_name}"
    if stem in BUILT_INS or name.startswith(OWN_PREFIX):
        name = name.replace(stem, f"{stem}.py", 1)  # a stranger's random.py must not pass for the built-in
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


def _baselines_folder() -> Path:
    """Folder of the installed ``baselines`` package, found without importing it."""
    found = importlib.util.find_spec("baselines")
    if found is None or not found.submodule_search_locations:
        raise MissingFileError("the package `baselines` is not installed", hint="pip install rema")
    return Path(next(iter(found.submodule_search_locations))).resolve()


def check_checkpoint(checkpoint: Path | None) -> Path | None:
    """The checkpoint as an absolute path, or a MissingFileError."""
    if checkpoint is None:
        return None
    path = checkpoint.expanduser()
    if not path.exists():
        raise MissingFileError(f"checkpoint {path} does not exist", hint="check the path after --checkpoint", path=path)
    return path.resolve()


def digest(spec: PolicySpec, checkpoint: Path | None) -> str:
    """Identity of a policy: sha256 over its class name, its code and its weights, hexadecimal.

    The code is the file and what it imports of its own (``own_modules``). A checkpoint folder counts with all its
    files, in sorted order.

    Raises
    ------
    MissingFileError
        When the code or the checkpoint is not there.
    """
    if not spec.path.is_file():
        raise MissingFileError(f"policy file {spec.path} does not exist", hint="check the path", path=spec.path)
    total = hashlib.sha256(spec.class_name.encode())
    for path in (spec.path, *own_modules(spec.path)):
        total.update(_file_digest(path))
    weights = check_checkpoint(checkpoint)
    if weights is not None:
        files = sorted(path for path in weights.rglob("*") if path.is_file()) if weights.is_dir() else [weights]
        for path in files:
            total.update(path.relative_to(weights).as_posix().encode())
            total.update(_file_digest(path))
    return total.hexdigest()


def _file_digest(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
