"""Writing files so that a crash or a full disk leaves the old file or the new one, never half of one."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import platformdirs

from rema_data import environment, repair
from rema_data.errors import MissingFileError, StorageError
from rema_data.leftovers import temporary_file

__all__ = [
    "absolute",
    "file_sha256",
    "new_file",
    "not_written",
    "rema_home",
    "storage_errors",
    "sync_file",
    "sync_folder",
    "write_atomic",
]

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


def absolute(path: str | os.PathLike[str]) -> Path:
    """A path as it is meant now, whatever folder the process works in later."""
    return Path(os.path.expanduser(path)).absolute()


def rema_home() -> Path:
    """Folder of everything that can be rebuilt or fetched again: ``REMA_HOME``, else the user's cache folder.

    A user without a home folder, as in many containers, has a folder of temporary files. Raises StorageError where that
    belongs to somebody else.
    """
    named = environment.folder_of(environment.HOME)
    if named is not None:
        return named
    try:
        usual = platformdirs.user_cache_path("rema", appauthor=False)
    except RuntimeError:  # no HOME, and no entry in the list of users
        return _home_of_nobody()
    if not usual.is_absolute():  # as earlier versions of platformdirs say it
        return _home_of_nobody()
    # containers give users whom they do not list the home folder "/", which is not theirs
    return usual if usual.parent != Path("/.cache") or _may_be_written(usual.parent) else _home_of_nobody()


def _may_be_written(folder: Path) -> bool:
    return os.access(folder if folder.exists() else folder.parent, os.W_OK)


def _home_of_nobody() -> Path:
    path = Path(tempfile.gettempdir()) / f"rema-{os.getuid()}"
    with suppress(FileNotFoundError):
        found = os.lstat(path)
        if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode):
            raise StorageError(
                f"this user has no home folder, and {path} is not a folder of this user",
                hint=f"set {environment.HOME} to a folder that you may write",
                path=str(path),
            )
    return path


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn the errors of a full or read-only disk, and of an impossible path, into a StorageError about ``path``.

    A file elsewhere that is not there, one that is read, is a MissingFileError. Other ``OSError`` pass through.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno not in _STORAGE:
            raise
        if error.errno == errno.ENOENT and not _is_written(error, path):
            raise MissingFileError(
                f"a file that is needed does not exist: {error.filename or error}",
                hint="restore it, then run the same command again",
                path=str(error.filename or ""),
            ) from error
        raise StorageError(
            f"cannot write {path}: {_STORAGE[error.errno]}",
            hint=_way_out(path, error.errno),
            path=str(path),
            errno=error.errno,
        ) from error


def _is_written(error: OSError, path: Path) -> bool:
    """Whether an error is about ``path``, what is below or above it, or what becomes it (``rema_data.leftovers``)."""
    target = absolute(path)
    becomes = str(target.parent / f".{target.name}.")
    for name in (error.filename, error.filename2):
        if isinstance(name, str | bytes):
            found = Path(os.fsdecode(name)).absolute()
            if found.is_relative_to(target) or target.is_relative_to(found) or str(found).startswith(becomes):
                return True
    return False


def _way_out(path: Path, number: int) -> str:
    """The hint of an error of the disk: all that lies in the folder of rema can lie elsewhere."""
    return repair.storage(number, environment.HOME if path.is_relative_to(rema_home()) else "")


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

    The block checks what it has written: a file that has its name counts as right. What killed processes left for the
    same path is removed.

    Raises
    ------
    StorageError
        The disk is full or may not be written; ``path`` is then as it was before.
    """
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_file(path) as (temporary, descriptor):
            try:
                with open(temporary, "w+b", opener=lambda *_: descriptor) as file:
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
    """Write bytes, or text as UTF-8, to ``path`` as ``new_file`` does; they are read back before it has its name."""
    content = data.encode() if isinstance(data, str) else data
    with new_file(path) as file:
        file.write(content)
        file.seek(0)
        if file.read() != content:
            raise not_written(path)


def not_written(path: Path, where: str = "") -> StorageError:
    """The error about a file that reads differently from what was written to it."""
    return StorageError(
        f"{path} was not written: what was read back is not what was written{where and f' ({where})'}",
        hint="run the same command again; if it happens again, check the disk or choose another folder",
        path=str(path),
    )
