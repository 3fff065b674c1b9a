"""Threads that fetch the missing files, largest first."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rema_data import interrupts
from rema_data.download.failures import Stopped, Undelivered
from rema_data.download.sources import Source
from rema_data.download.transfer import Mirrors, Transfer
from rema_data.progress import Progress
from rema_data.release.manifest import FileEntry

__all__ = ["Outcome", "fetch_files"]

_GRACE_S = 1.0
"""So long an interrupted download waits for its threads. One that is stuck in a read ends later and writes nothing."""


_Done = queue.SimpleQueue[tuple[int, BaseException | None]]
"""What came of every file: bytes that came from the sources, and the error."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the threads have done."""

    moved: int  # bytes that came from the sources
    used: dict[str, int]  # files that every source has delivered, by its label
    undelivered: tuple[Undelivered, ...]  # files that no source has delivered


def fetch_files(
    entries: Sequence[FileEntry], root: Path, sources: Sequence[Source], jobs: int, progress: Progress
) -> Outcome:
    """Fetch files to ``root``; those that no source delivers are in the outcome. A full disk raises StorageError."""
    stop, lock = threading.Event(), threading.Lock()
    waiting: queue.SimpleQueue[FileEntry] = queue.SimpleQueue()
    done: _Done = queue.SimpleQueue()
    for entry in sorted(entries, key=lambda entry: -entry.bytes):
        waiting.put(entry)

    def note(text: str) -> None:
        with lock:
            progress.note(text)

    def advance(n: int) -> None:
        with lock:
            progress.advance(n)

    mirrors = Mirrors(sources, patience=jobs + 2, note=note)

    def work() -> None:
        while not stop.is_set():
            try:
                entry = waiting.get_nowait()
            except queue.Empty:
                return
            transfer = Transfer(entry, root / entry.location, mirrors, advance, stop)
            error: BaseException | None = None
            try:
                transfer.run()
            except Stopped:
                return
            except BaseException as caught:
                error = caught
            done.put((transfer.moved, error))

    count = min(jobs, len(entries))
    threads = [threading.Thread(target=work, name=f"rema download {n}", daemon=True) for n in range(count)]
    moved, undelivered = 0, []
    try:
        for thread in threads:
            thread.start()
        for _ in entries:
            bytes_moved, error = _next(done)
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


def _next(done: _Done) -> tuple[int, BaseException | None]:
    """The next file that is done with."""
    while True:
        interrupts.check()
        try:
            return done.get(timeout=interrupts.POLL_S)
        except queue.Empty:
            continue
