"""Locks between processes: a file that one process holds, and that the system frees when the process ends."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rema_data.environment import HOME
from rema_data.errors import StorageError
from rema_data.interrupts import POLL_S, check

__all__ = ["LOCAL_HOME", "Busy", "has_no_locks", "lock"]

_NO_LOCKS = {getattr(errno, name) for name in ("ENOSYS", "ENOLCK", "EOPNOTSUPP", "ENOTSUP") if hasattr(errno, name)}
_FOLDER = "choose a folder on a local disk"
LOCAL_HOME = f"set {HOME} to a folder on a local disk"
"""The hint for what lies below ``rema_home``."""


class Busy(Exception):
    """Another process holds the lock."""


def has_no_locks(error: BaseException | None) -> bool:
    """Whether an error of a lock means that the file system has none."""
    return isinstance(error, NotImplementedError) or (isinstance(error, OSError) and error.errno in _NO_LOCKS)


@contextmanager
def lock(
    path: Path, *, wait: bool = False, waiting: Callable[[], None] | None = None, hint: str = _FOLDER
) -> Iterator[None]:
    """Hold the lock file ``path`` inside the block.

    Raises Busy where another process holds it, or waits for that process (``wait``) and calls ``waiting`` once. Raises
    StorageError, with ``hint``, where the file system has no locks; other errors of the system pass through.
    """
    from filelock import Timeout  # takes its time to import

    held, told = _file_lock(path), False
    while True:
        try:
            held.acquire(timeout=0)
            break
        except Timeout as error:
            if not wait:
                raise Busy(str(path)) from error
        except (OSError, NotImplementedError) as error:
            if not has_no_locks(error):
                raise
            raise StorageError(
                f"the file system of {path.parent} has no file locks", hint=hint, path=str(path)
            ) from error
        if waiting is not None and not told:
            waiting()
            told = True
        check()
        time.sleep(POLL_S)
    try:
        yield
    finally:
        held.release()


def _file_lock(path: Path) -> Any:
    """A lock that refuses a file system without locks: files in their place stay behind when a process is killed."""
    from filelock import FileLock

    try:
        return FileLock(path, fallback_to_soft=False)
    except TypeError:  # an earlier filelock: it always refuses
        return FileLock(path)
