"""The sha256 of bytes that arrive, computed while the next ones arrive."""

from __future__ import annotations

import hashlib
import io
import threading
from queue import SimpleQueue

__all__ = ["Digest"]

_BLOCK = 2 << 20
"""Bytes that are hashed at a time: few enough to be in the caches still, and as many as a store sends at a time."""
_BLOCKS = 4
_LARGE = 2 * _BLOCK
"""More bytes than these are hashed by a thread of their own."""


class Digest:
    """A few blocks that are filled one after the other, and hashed by another thread meanwhile.

    Parameters
    ----------
    size : int
        Bytes that are expected; with few there is no thread.
    """

    def __init__(self, size: int) -> None:
        self._hash = hashlib.sha256()
        self._length = max(1, min(size, _BLOCK))
        self._block = memoryview(bytearray(self._length))
        self._filled = 0
        self._full: SimpleQueue[memoryview | None] = SimpleQueue()
        self._hashed: SimpleQueue[memoryview] = SimpleQueue()
        self._away = 0
        """Blocks that are with the thread, or have come back and wait to be filled again."""
        self._thread: threading.Thread | None = None
        if size > _LARGE:
            self._thread = threading.Thread(target=self._work, name="rema sha256", daemon=True)
            self._thread.start()

    def read(self, file: io.FileIO) -> None:
        """Begin with the bytes of a file."""
        self._hash = hashlib.file_digest(file, "sha256")

    def space(self) -> memoryview:
        """Where the next bytes belong; never empty."""
        return self._block[self._filled :]

    def add(self, count: int) -> memoryview:
        """The next ``count`` bytes are in the space. They, valid until more are put there."""
        added = self._block[self._filled : self._filled + count]
        self._filled += count
        if self._filled == self._length:
            self._hash_block()
            self._filled = 0
        return added

    def hexdigest(self) -> str:
        """Of every byte so far."""
        self._wait()
        whole = self._hash.copy()
        whole.update(self._block[: self._filled])
        return whole.hexdigest()

    def restart(self) -> None:
        """Forget every byte."""
        self._wait()
        self._hash = hashlib.sha256()
        self._filled = 0

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._full.put(None)
            self._thread.join()

    def _hash_block(self) -> None:
        """Hash a full block, and go on with one that is not being hashed."""
        if self._thread is None:
            self._hash.update(self._block)
            return
        self._full.put(self._block)
        if self._away < _BLOCKS - 1:
            self._away += 1
            self._block = memoryview(bytearray(self._length))
        else:
            self._block = self._hashed.get()

    def _wait(self) -> None:
        """Until no block is being hashed."""
        for block in [self._hashed.get() for _ in range(self._away)]:
            self._hashed.put(block)

    def _work(self) -> None:
        while (block := self._full.get()) is not None:
            self._hash.update(block)
            self._hashed.put(block)
