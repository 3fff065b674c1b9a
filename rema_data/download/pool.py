"""Threads that fetch the missing files, largest first."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rema_data.download.mirrors import Mirrors
from rema_data.download.sources import Source
from rema_data.download.transfer import Stopped, Transfer, Undelivered
from rema_data.release.manifest import FileEntry

__all__ = ["Outcome", "Progress", "Serialised", "Silent", "fetch_files"]

_GRACE_S = 1.0
"""So long an interrupted download waits for its threads. One that is stuck in a read ends later and writes nothing."""


class Progress(Protocol):
    """Where a download says how far it is. Its methods are called by one thread at a time."""

    def phase(self, name: str, total: int) -> None:
        """A phase of ``total`` bytes begins."""
        ...

    def advance(self, n: int) -> None:
        """So many bytes more are there; negative where bytes were thrown away."""
        ...

    def note(self, text: str) -> None:
        """Something worth a line."""
        ...


class Silent:
    """Progress that shows nothing."""

    def phase(self, name: str, total: int) -> None:
        """Ignore."""

    def advance(self, n: int) -> None:
        """Ignore."""

    def note(self, text: str) -> None:
        """Ignore."""


class Serialised:
    """Progress that threads share."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._lock = threading.Lock()

    def phase(self, name: str, total: int) -> None:
        """As ``Progress.phase``."""
        with self._lock:
            self._progress.phase(name, total)

    def advance(self, n: int) -> None:
        """As ``Progress.advance``."""
        with self._lock:
            self._progress.advance(n)

    def note(self, text: str) -> None:
        """As ``Progress.note``."""
        with self._lock:
            self._progress.note(text)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the threads have done.

    Attributes
    ----------
    moved : int
        Bytes that came from the sources.
    used : dict of str to int
        Files that every source has delivered, by its label.
    undelivered : tuple of Undelivered
        Files that no source has delivered.
    """

    moved: int
    used: dict[str, int]
    undelivered: tuple[Undelivered, ...]


def fetch_files(
    entries: Sequence[FileEntry], root: Path, sources: Sequence[Source], jobs: int, progress: Progress
) -> Outcome:
    """Fetch files to ``root``; the ones that no source delivers are in the outcome.

    Raises
    ------
    StorageError
        The disk is full or may not be written: the other threads are stopped. What has arrived stays.
    """
    shared = Serialised(progress)
    mirrors = Mirrors(sources, patience=jobs + 2, note=shared.note)
    stop = threading.Event()
    waiting: queue.SimpleQueue[FileEntry] = queue.SimpleQueue()
    done: queue.SimpleQueue[tuple[int, BaseException | None]] = queue.SimpleQueue()
    for entry in sorted(entries, key=lambda entry: -entry.bytes):
        waiting.put(entry)
    work = _worker(root, mirrors, shared, stop, waiting, done)
    count = min(jobs, len(entries))
    threads = [threading.Thread(target=work, name=f"rema download {n}", daemon=True) for n in range(count)]
    moved, undelivered = 0, []
    try:
        for thread in threads:
            thread.start()
        for _ in entries:
            bytes_moved, error = done.get()
            moved += bytes_moved
            if isinstance(error, Undelivered):
                undelivered.append(error)
            elif error is not None:
                raise error
    finally:
        stop.set()
        for thread in threads:
            if thread.ident is not None:
                thread.join(_GRACE_S / len(threads))
        for source in sources:
            source.close()
    return Outcome(moved, mirrors.used(), tuple(undelivered))


def _worker(
    root: Path,
    mirrors: Mirrors,
    progress: Progress,
    stop: threading.Event,
    waiting: queue.SimpleQueue[FileEntry],
    done: queue.SimpleQueue[tuple[int, BaseException | None]],
) -> Callable[[], None]:
    """What a thread does: fetch files until there are none."""

    def work() -> None:
        while not stop.is_set():
            try:
                entry = waiting.get_nowait()
            except queue.Empty:
                return
            transfer = Transfer(entry, root / entry.location, mirrors, progress.advance, stop)
            error: BaseException | None = None
            try:
                transfer.run()
            except Stopped:
                return
            except BaseException as caught:
                error = caught
            done.put((transfer.moved, error))

    return work
