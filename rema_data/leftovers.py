"""Temporary files and folders, and the removal of those that a killed process left.

The process that makes one locks it until it is gone or has its name; the kernel frees the lock when the process ends.
So the next run knows which of them belong to nobody. Where the file system has no locks, nothing is removed.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["remove_abandoned", "temporary_file", "temporary_folder"]

_RANDOM = r"[a-z0-9_]{8}"
"""What ``tempfile`` adds to a prefix."""


@contextmanager
def temporary_file(path: Path) -> Iterator[tuple[Path, int]]:
    """A new file beside ``path``, ``.NAME.????????``, and its descriptor; the caller closes it, and renames the file.

    Those that dead processes left for the same path are removed before.
    """
    prefix = f".{path.name}."
    remove_abandoned(path.parent, prefix)
    while True:
        descriptor, name = tempfile.mkstemp(prefix=prefix, dir=path.parent)
        with ExitStack() as held:
            try:
                locked = held.enter_context(_locked(Path(name)))
            except OSError:
                os.close(descriptor)
                Path(name).unlink(missing_ok=True)
                raise
            if locked is not False:
                yield Path(name), descriptor
                return
        os.close(descriptor)


@contextmanager
def temporary_folder(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """A new folder ``PREFIX????????``, removed at the end of the block; those of dead processes are removed before.

    ``parent`` is by default the system's folder for temporary files; it is made where it is missing, and removed again
    where nothing else is in it at the end.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    missing = [folder for folder in (place, *place.parents) if not folder.exists()]
    place.mkdir(parents=True, exist_ok=True)
    remove_abandoned(place, prefix)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
        with ExitStack() as held:
            try:
                locked = held.enter_context(_locked(folder))
            except OSError:
                folder.rmdir()
                raise
            if locked is not False:
                try:
                    yield folder
                finally:
                    shutil.rmtree(folder, ignore_errors=True)
                    with suppress(OSError):  # not empty, or removed by somebody else
                        for made in missing:
                            made.rmdir()
                return


def remove_abandoned(parent: Path, prefix: str) -> None:
    """Remove the temporary files and folders of dead processes: ``PREFIX`` and what ``tempfile`` adds to it."""
    pattern = re.compile(re.escape(prefix) + _RANDOM)
    with suppress(OSError), os.scandir(parent) as entries:
        found = [Path(entry.path) for entry in entries if pattern.fullmatch(entry.name) and not entry.is_symlink()]
        for path in found:
            with suppress(OSError), _locked(path) as locked:  # it may be another user's
                if locked and path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                elif locked:
                    path.unlink(missing_ok=True)


@contextmanager
def _locked(path: Path) -> Iterator[bool | None]:
    """Hold the lock of a file or folder in the block: whether it could be had; None where the system has no locks.

    Raises OSError where the file cannot be opened, although it is there.
    """
    if fcntl is None:
        yield None
        return
    try:
        descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)  # NFS locks only what may be written
    except FileNotFoundError:  # another process has removed it
        yield False
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        except OSError:
            yield None
        else:
            yield _leads_to(path, descriptor)
    finally:
        os.close(descriptor)


def _leads_to(path: Path, descriptor: int) -> bool:
    """Whether a path is still that of an open file: another process may have removed it before it was locked."""
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except OSError:
        return False
