"""Opening HDF5 files so that a full disk and a damaged file are errors of ours, and no file is ever half there."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import h5py

from rema_data import storage
from rema_data.convert.hdf5_written import Written
from rema_data.errors import IntegrityError, MissingFileError, RemaError
from rema_data.progress import Progress

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

__all__ = ["FORMAT", "VERSION", "damaged", "new_file", "open_file", "reading"]

FORMAT = "rema episodes for robomimic"
VERSION = 1
"""Of the layout that ``hdf5`` describes."""

_LIBVER = ("v110", "v110")
"""Read by HDF5 1.10 and later: checksums on all metadata, and a third of the size of the older form."""


class _Sink(io.RawIOBase):
    """A file that remembers the first thing the disk refuses and swallows what comes after it.

    Left to itself, HDF5 loses what a full disk refuses while an array is closed, or ends the process.
    """

    def __init__(self, file: io.RawIOBase) -> None:
        self._file = file
        self.error: OSError | None = None

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        return self._file.readinto(buffer) or 0

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def write(self, data: ReadableBuffer) -> int:
        view = memoryview(data)
        total = len(view)
        try:
            while self.error is None and view:
                view = view[self._file.write(view) or 0 :]
        except OSError as error:
            self.error = error
        return total

    def truncate(self, size: int | None = None) -> int:
        try:
            return self._file.truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0

    def check(self) -> None:
        """Raise the first error of the disk."""
        if self.error is not None:
            raise self.error


@contextmanager
def new_file(path: Path, progress: Progress) -> Iterator[tuple[Written, Callable[[], None]]]:
    """As ``storage.new_file``, for HDF5; and a function that raises the OSError of the first refused write.

    All parts are read back before the file gets its name.
    """
    with storage.new_file(path) as file:
        sink = _Sink(file.raw)
        with h5py.File(sink, "w", libver=_LIBVER) as root:
            written = Written(root)
            yield written, sink.check
        sink.check()
        progress.phase(f"check {path.stem}", len(written))
        if (where := written.differs(Path(file.name), progress)) is not None:
            raise storage.not_written(path, where)


def damaged(path: Path, why: str) -> IntegrityError:
    """The error about a file that is not a whole export."""
    return IntegrityError(
        f"{path} cannot be read: {why}",
        hint="export the release again, or restore the file from a copy",
        path=str(path),
    )


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what HDF5 raises on a damaged or missing part of ``path`` into an IntegrityError."""
    try:
        yield
    except RemaError:
        raise
    except KeyError as error:
        raise damaged(path, f"a part of it is missing ({error.args[0]})") from error
    except (OSError, RuntimeError, ValueError, TypeError, AttributeError) as error:  # a damaged link reads as None
        raise damaged(path, f"it is truncated or damaged ({error})") from error


def open_file(path: Path) -> h5py.File:
    """An HDF5 file for reading; raises MissingFileError or IntegrityError where there is no whole HDF5 file."""
    if not path.is_file():
        raise MissingFileError(
            f"there is no file {path}", hint="name the files that `rema export` wrote, or their folder", path=str(path)
        )
    if not h5py.is_hdf5(path):
        raise damaged(path, "it is not an HDF5 file")
    with reading(path):
        return h5py.File(path, "r", locking=False)  # nobody writes into a finished file; not every disk has locks
