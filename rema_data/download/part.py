"""The bytes of a file that have arrived: ``NAME.part`` beside its future place, until all are there and right."""

from __future__ import annotations

import hashlib
import os
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

from rema_data.storage import storage_errors, sync_folder

__all__ = ["SUFFIX", "PartFile"]

SUFFIX = ".part"
_READ_ONLY = 0o444
_LARGE = 4 << 20
"""Files of so many bytes are hashed and flushed by threads of their own, while the next bytes arrive."""
_FLUSH = 32 << 20
"""Bytes after which a flush to the disk begins, so that the last one is short."""


class PartFile:
    """A file that is being fetched, as a context manager. What is there from an earlier run is kept and hashed.

    Parameters
    ----------
    target : Path
        Where the file will be.
    size : int
        Bytes of the whole file.

    Attributes
    ----------
    position : int
        Bytes that are there.
    """

    def __init__(self, target: Path, size: int) -> None:
        self.target = target
        self.path = target.with_name(target.name + SUFFIX)
        self.size = size
        self.position = 0
        self._hashing: Future[None] | None = None
        self._flushing: Future[None] | None = None
        self._unflushed = 0

    def __enter__(self) -> Self:
        with storage_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("a+b", buffering=0)  # unbuffered: what was written survives a kill
            try:
                self.position = self._file.tell()
                if self.position > self.size:
                    self._file.truncate(0)
                    self.position = 0
                self._file.seek(0)
                self._hash = hashlib.file_digest(self._file, "sha256")
            except BaseException:
                self._file.close()
                raise
        self._threads = ThreadPoolExecutor(2, "rema part") if self.size >= _LARGE else None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._threads is not None:
            self._threads.shutdown()
        self._file.close()

    def append(self, data: bytes) -> None:
        """Add the next bytes.

        Raises
        ------
        StorageError
            The disk is full, for example.
        """
        view = memoryview(data)
        with storage_errors(self.path):
            while view:
                view = view[self._file.write(view) :]
            if self._threads is not None:
                self._begin_to_flush(len(data), self._threads)
        self._wait_for_hash()
        if self._threads is None:
            self._hash.update(data)
        else:
            self._hashing = self._threads.submit(self._hash.update, data)
        self.position += len(data)

    def restart(self) -> None:
        """Throw away what is there."""
        with storage_errors(self.path):
            self._file.truncate(0)
        self._wait_for_hash()
        self._hash = hashlib.sha256()
        self.position = 0

    def discard(self) -> None:
        """Leave nothing behind."""
        with storage_errors(self.path):
            self.path.unlink(missing_ok=True)

    def matches(self, sha256: str) -> bool:
        """Whether the file is whole, and the right one."""
        self._wait_for_hash()
        return self.position == self.size and self._hash.hexdigest() == sha256

    def finish(self) -> None:
        """Give the file its name. Every byte is on the disk before, and the file is read-only after."""
        with storage_errors(self.target):
            if self._flushing is not None:
                self._flushing.result()
            os.fsync(self._file.fileno())
            self.path.chmod(_READ_ONLY)
            self.path.replace(self.target)
            sync_folder(self.target.parent)

    def _begin_to_flush(self, written: int, threads: ThreadPoolExecutor) -> None:
        """Flush in the background once enough has been written; an error of an earlier flush is raised here."""
        self._unflushed += written
        if self._unflushed >= _FLUSH and (self._flushing is None or self._flushing.done()):
            if self._flushing is not None:
                self._flushing.result()
            self._flushing = threads.submit(os.fsync, self._file.fileno())
            self._unflushed = 0

    def _wait_for_hash(self) -> None:
        """Until every byte that was appended is in the hash."""
        if self._hashing is not None:
            self._hashing.result()
            self._hashing = None
