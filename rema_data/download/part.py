"""The bytes of a file that have arrived: ``NAME.part`` beside its future place, until all are there and right."""

from __future__ import annotations

import hashlib
import io
import os
import queue
import threading
from pathlib import Path

from rema_data.storage import storage_errors, sync_folder

__all__ = ["SUFFIX", "PartFile"]

SUFFIX = ".part"
_READ_ONLY = 0o444
_WRITE = 1 << 16
"""Bytes of one write. Linux takes larger pages of memory for larger ones, which were up to five times slower on a
virtual machine; with smaller ones the threads of several files hold each other up."""
_FLUSH = 8 << 20
"""Bytes after which the system is told to begin writing them to the disk, so that the flush at the end is short."""
_LARGE = 4 << 20
"""More bytes than these are hashed by a thread of their own, while the next ones arrive."""
_AHEAD = 4
"""Pieces that wait to be hashed, at most."""


class PartFile:
    """A file of ``size`` bytes that is being fetched, open until ``close``.

    What an earlier run left is kept and hashed; ``position`` counts the bytes that are there. Every method raises
    StorageError where the disk is full.
    """

    def __init__(self, target: Path, size: int) -> None:
        self.target = target
        self.path = target.with_name(target.name + SUFFIX)
        self.size = size
        with storage_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("a+b", buffering=0)  # unbuffered: what was written survives a kill
            try:
                if self._file.tell() > size:
                    self._file.truncate(0)
                self.position = self._begun = self._file.seek(0, os.SEEK_END)
                self._file.seek(0)
                self._digest = _Digest(self._file, size - self.position > _LARGE)
            except BaseException:
                self._file.close()
                raise

    def close(self) -> None:
        """Close the file; what has arrived stays."""
        self._digest.close()
        self._file.close()

    def add(self, data: bytes) -> None:
        """Add the next bytes."""
        self._digest.update(data)
        view = memoryview(data)
        with storage_errors(self.path):
            while view:
                view = view[self._file.write(view[:_WRITE]) :]
            self.position += len(data)
            if self.position - self._begun >= _FLUSH:
                self._begin_to_flush()

    def restart(self) -> None:
        """Throw away what is there."""
        with storage_errors(self.path):
            self._file.truncate(0)
        self._digest.restart()
        self.position = self._begun = 0

    def discard(self) -> None:
        """Leave nothing behind."""
        with storage_errors(self.path):
            self.path.unlink(missing_ok=True)

    def matches(self, sha256: str) -> bool:
        """Whether the file is whole, and the right one."""
        return self.position == self.size and self._digest.hexdigest() == sha256

    def finish(self) -> None:
        """Give the file its name. Every byte is on the disk before, and the file is read-only after."""
        with storage_errors(self.target):
            os.fsync(self._file.fileno())
            self.path.chmod(_READ_ONLY)
            self.path.replace(self.target)
            sync_folder(self.target.parent)

    def _begin_to_flush(self) -> None:
        """Have the newest bytes written to the disk in the background; an fsync would hold up the next ones."""
        if hasattr(os, "posix_fadvise"):
            # Bytes that are not on the disk yet are not dropped from memory by this: their writing begins.
            advice = os.POSIX_FADV_DONTNEED
            os.posix_fadvise(self._file.fileno(), self._begun, self.position - self._begun, advice)
        self._begun = self.position


class _Digest:
    """The sha256 of a file and of the bytes that are added to it, hashed by another thread where they are many."""

    def __init__(self, file: io.FileIO, threaded: bool) -> None:
        self._hash = hashlib.file_digest(file, "sha256")
        self._waiting: queue.Queue[bytes | None] = queue.Queue(_AHEAD)
        self._threaded = threaded
        if threaded:
            threading.Thread(target=self._work, name="rema sha256", daemon=True).start()

    def update(self, data: bytes) -> None:
        if self._threaded:
            self._waiting.put(data)
        else:
            self._hash.update(data)

    def hexdigest(self) -> str:
        self._waiting.join()
        return self._hash.hexdigest()

    def restart(self) -> None:
        self._waiting.join()
        self._hash = hashlib.sha256()

    def close(self) -> None:
        if self._threaded:
            self._waiting.put(None)

    def _work(self) -> None:
        while (data := self._waiting.get()) is not None:
            self._hash.update(data)
            self._waiting.task_done()
