"""Who is writing in a run folder: one process at a time."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from rema_data.errors import InputError
from rema_data.storage import storage_errors

__all__ = ["being_written", "locked"]

_LOCK_FILE = ".lock"
_NOT_WRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS)


@contextmanager
def locked(folder: Path, hint: str, *, only_reading: bool = False) -> Iterator[None]:
    """Hold a run folder for this process alone.

    A reader (``only_reading``) of a folder that cannot be written goes on without the lock.

    Raises
    ------
    InputError
        Another process holds it; ``hint`` says what to do then.
    """
    lock = FileLock(folder / _LOCK_FILE, timeout=0)
    try:
        with storage_errors(folder):
            try:
                lock.acquire()
            except OSError as error:
                if not (only_reading and error.errno in _NOT_WRITABLE):
                    raise
    except Timeout as error:
        raise InputError(f"another process is writing in {folder}", hint=hint, path=str(folder)) from error
    try:
        yield
    finally:
        lock.release()


def being_written(folder: Path) -> bool:
    """Whether a process is writing in a run folder at this moment, as far as this process may ask."""
    if not (folder / _LOCK_FILE).exists():
        return False
    try:
        with FileLock(folder / _LOCK_FILE, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False
