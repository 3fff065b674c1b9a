"""Which files are a policy: those of its folder that it may read, and those of its checkpoint."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from evaluator.policy.imports import outermost_folder
from evaluator.policy.sandbox.allowlist import crowded_places, installation, is_code, scenario_lists, secrets
from rema_data.errors import InputError
from rema_data.storage import rema_home

__all__ = ["CODE_BYTES", "CODE_FILES", "Entry", "Sources", "checkpoint_sources", "code_sources"]

CODE_BYTES = 2 << 30
"""Most bytes in the folder of a policy's file."""
CODE_FILES = 10_000
"""Most files in it."""
_CHECKPOINT_FILES = 100_000
_ENVIRONMENT = "pyvenv.cfg"
_RUN = "run.json"
_DOTTED = "its name is hidden"
_LOG = "it is a log"
_SUFFIXES_OF_LOGS = (".log",)
_NAMES_OF_LOGS = ("nohup.out",)


@dataclass(frozen=True, slots=True)
class Entry:
    """One file that is copied and hashed."""

    name: str  # relative to the folder, with slashes; "." where the checkpoint is one file
    source: Path


@dataclass(frozen=True, slots=True)
class Sources:
    """Files of one folder (or one file), sorted by name, and what of it is left out."""

    root: Path
    entries: tuple[Entry, ...]
    left_out: Mapping[Path, str] = field(default_factory=dict)  # path -> why
    hidden: tuple[Path, ...] = ()  # originals that the policy must not read beside their copies

    @property
    def size(self) -> int:
        """Bytes in all files."""
        total = 0
        for entry in self.entries:
            with suppress(OSError):
                total += entry.source.stat().st_size
        return total


def code_sources(policy: Path, hidden: Iterable[Path] = ()) -> Sources:
    """The files that a policy may read of the folder of its file (of its outermost package).

    All visible files, without links that lead outside, Python environments, runs, logs, what is ``hidden``, and what no
    policy may read. In a crowded folder, only files and Python packages. InputError where they are too many.
    """
    root = outermost_folder(policy)
    unseen = frozenset(path.resolve() for path in (*secrets(), *hidden))
    walk = _Walk(_code_reason(root.resolve(), unseen, policy), CODE_FILES, _too_large(root, policy))
    entries = _sorted(walk.files(root, ""))
    tops = {root / entry.name.partition("/")[0] for entry in entries}
    tops |= {path for path, why in walk.left_out.items() if path.parent == root and why in (_DOTTED, _LOG)}
    found = Sources(root, entries, walk.left_out, tuple(sorted(tops)))
    if found.size > CODE_BYTES:
        raise _too_large(root, policy)
    return found


def checkpoint_sources(checkpoint: Path) -> Sources:
    """The file of a checkpoint, or all files of its folder.

    A link may lead to another file of the folder, or into the ``blobs`` of a Hugging Face cache. InputError for any
    other link, and for what is not a regular file.
    """
    if not checkpoint.is_dir():
        return Sources(checkpoint, (Entry(".", checkpoint),))
    root = checkpoint.resolve()
    too_many = InputError(
        f"checkpoint {checkpoint} holds more than {_CHECKPOINT_FILES:,} files",
        hint="name the folder that holds the weights alone",
        path=checkpoint,
    )
    walk = _Walk(_checkpoint_reason(checkpoint, root), _CHECKPOINT_FILES, too_many)
    return Sources(checkpoint, _sorted(walk.files(checkpoint, "")))


def _sorted(entries: Iterable[Entry]) -> tuple[Entry, ...]:
    """In the order of paths, which is not that of their texts."""
    return tuple(sorted(entries, key=lambda entry: entry.name.split("/")))


Reason = Callable[[Path, os.DirEntry[str]], str]
"""Why an entry of a folder is left out; empty: it is not."""


class _Walk:
    """Finds the files below a folder; a link is followed where ``reason`` allows it, and never round in a circle."""

    def __init__(self, reason: Reason, most: int, too_many: InputError) -> None:
        self.left_out: dict[Path, str] = {}
        self._reason, self._left, self._too_many = reason, most, too_many

    def files(self, folder: Path, prefix: str, around: tuple[Path, ...] = ()) -> Iterator[Entry]:
        """Files below ``folder``, whose name is ``prefix`` and which is inside of the folders ``around``."""
        around = (*around, folder.resolve())
        try:
            with os.scandir(folder) as found:
                entries = sorted(found, key=lambda entry: entry.name)
        except OSError as error:
            self.left_out[folder] = f"it cannot be read ({error.strerror})"
            return
        for entry in entries:
            path = Path(entry.path)
            if why := self._reason(path, entry):
                self.left_out[path] = why
            elif entry.is_dir():
                if path.resolve() in around:
                    self.left_out[path] = "it is a link to a folder around it"
                else:
                    yield from self.files(path, f"{prefix}{entry.name}/", around)
            else:
                self._left -= 1
                if self._left < 0:
                    raise self._too_many
                yield Entry(f"{prefix}{entry.name}", path)


def _code_reason(root: Path, unseen: frozenset[Path], policy: Path) -> Reason:
    crowded, printed = crowded_places(), _own_output()
    installed = installation()
    around = frozenset(parent for folder in installed for parent in folder.parents)

    def reason(path: Path, entry: os.DirEntry[str]) -> str:
        if path == policy:
            return ""
        place = path.resolve()
        if place in installed or (place in around and place not in policy.parents):
            return "it belongs to the Python installation"
        if entry.name.startswith(".") or entry.name == "__pycache__":
            return _DOTTED
        if any(secret in (place, *place.parents) for secret in unseen):
            return "no policy may read it"
        if entry.is_symlink() and not place.is_relative_to(root):
            return f"it is a link that leads outside of the policy's folder, to {place}"
        if entry.is_dir():
            return _folder_reason(path, entry, crowded)
        if not entry.is_file():
            return "it is not a regular file"
        if entry.name.endswith(_SUFFIXES_OF_LOGS) or entry.name in _NAMES_OF_LOGS or _identity(path) in printed:
            return _LOG
        return "" if os.access(path, os.R_OK) else "it cannot be read (Permission denied)"

    return reason


def _folder_reason(path: Path, entry: os.DirEntry[str], crowded: tuple[Path, ...]) -> str:
    if (path / _ENVIRONMENT).is_file():
        return "it is a Python environment"
    if (path / _RUN).is_file():
        return "it is a run"
    if any(path.parent.resolve() in (other, *other.parents) for other in crowded) and not is_code(entry):
        return f"{path.parent} holds much besides code: only files and Python packages are taken from it"
    return ""


def _identity(path: Path) -> tuple[int, int] | None:
    with suppress(OSError):
        found = path.stat()
        return found.st_dev, found.st_ino
    return None


def _own_output() -> set[tuple[int, int] | None]:
    """The files that this process prints to: they grow while a policy is evaluated."""
    found: set[tuple[int, int] | None] = set()
    for number in (1, 2):
        with suppress(OSError):
            about = os.fstat(number)
            if stat.S_ISREG(about.st_mode):
                found.add((about.st_dev, about.st_ino))
    return found


def _too_large(root: Path, policy: Path) -> InputError:
    return InputError(
        f"{root} holds more than {CODE_FILES:,} files or {CODE_BYTES >> 30} GiB beside {policy.name}",
        hint="a policy runs from a copy of its folder: give it a folder of its own, and name large weights with "
        "--checkpoint",
        path=root,
    )


def _checkpoint_reason(checkpoint: Path, root: Path) -> Reason:
    caches = [
        parent.parent / "blobs"
        for start in (root, Path(os.path.abspath(checkpoint)))
        for parent in (start, *start.parents)
        if parent.name == "snapshots" and (parent.parent / "blobs").is_dir()
    ]
    places = (root, *(cache.resolve() for cache in caches))
    unseen = [path.resolve() for path in (*scenario_lists(), rema_home() / "observations")]

    def reason(path: Path, entry: os.DirEntry[str]) -> str:
        place = path.resolve()
        if any(secret in (place, *place.parents) for secret in unseen):
            raise _refused(checkpoint, path, "not for policies: it holds scenarios or their observations")
        if not (entry.is_file() or entry.is_dir()):
            what = "a link that leads nowhere" if entry.is_symlink() and not path.exists() else "not a regular file"
            raise _refused(checkpoint, path, what)
        if entry.is_symlink() and not any(place.is_relative_to(one) for one in places):
            raise _refused(checkpoint, path, f"a link that leads outside of it, to {place}")
        return ""

    return reason


def _refused(checkpoint: Path, path: Path, what: str) -> InputError:
    return InputError(
        f"checkpoint {checkpoint}: {path} is {what}",
        hint=f"copy the weights to a folder of their own (cp -rL {checkpoint} NEW), remove it there, and name that one",
        path=path,
    )
