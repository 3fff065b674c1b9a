"""Writing files so that a crash or a full disk leaves the old file or the new one, never half of one."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import platformdirs

from rema_data import repair
from rema_data.errors import StorageError

__all__ = ["file_sha256", "new_file", "rema_home", "storage_errors", "sync_file", "sync_folder", "write_atomic"]

_STORAGE = {
    errno.ENOSPC: "no space is left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "the folder may not be written",
    errno.EPERM: "the folder may not be written",
    errno.EIO: "the disk reports an input/output error",
    errno.EFBIG: "the file would be larger than is allowed here",
    errno.EEXIST: "a file of that name is in the way",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EISDIR: "there is a folder of that name",
    errno.ENOENT: "the folder cannot be created",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ELOOP: "the path is a loop of links",
}


def rema_home() -> Path:
    """Folder of everything that can be rebuilt or fetched again: ``REMA_HOME``, else the user's cache folder."""
    home = os.environ.get("REMA_HOME")
    return Path(home).expanduser() if home else platformdirs.user_cache_path("rema", appauthor=False)


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn the errors of a full or read-only disk, and of an impossible path, into a StorageError about ``path``.

    Other ``OSError`` pass through.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno not in _STORAGE:
            raise
        raise StorageError(
            f"cannot write {path}: {_STORAGE[error.errno]}",
            hint=repair.storage(error.errno),
            path=str(path),
            errno=error.errno,
        ) from error


def file_sha256(path: Path) -> str:
    """sha256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync_file(path: Path) -> None:
    """Make the content of a file survive a power cut."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` survive a power cut, where the system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def new_file(path: Path) -> Iterator[io.BufferedRandom]:
    """A file under a temporary name, which becomes ``path`` when the block ends without an error.

    Raises
    ------
    StorageError
        The disk is full or may not be written; ``path`` is then as it was before.
    """
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        temporary = Path(name)
        try:
            with os.fdopen(descriptor, "w+b") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.chmod(0o644)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)


def write_atomic(path: Path, data: bytes | str) -> None:
    """Write bytes, or text as UTF-8, to ``path`` as ``new_file`` does."""
    with new_file(path) as file:
        file.write(data.encode() if isinstance(data, str) else data)
