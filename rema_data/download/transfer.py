"""One file, from one source after the other, until it is whole and its sha256 is right.

The sources are asked in order, and the next one at once where one fails. Only when all have failed does a thread wait,
and asks again those that may recover. A dropped connection resumes at the byte where it stopped.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

from rema_data.download.failures import Faltered, Refused, Stopped, Undelivered
from rema_data.download.part import PartFile
from rema_data.download.sources import Source
from rema_data.release.manifest import FileEntry

__all__ = ["Mirrors", "Transfer"]

WAITS_S = (0.0, 0.5, 1.0, 2.0)
"""Pause before every pass over the sources, s."""
LONGEST_WAIT_S = 30.0
"""However long a server asks us to wait."""
DROPS = 8
"""Connections in a row that may drop without an end, and one more for each ``BYTES_PER_DROP`` that have arrived."""
BYTES_PER_DROP = 1 << 20


class Mirrors:
    """The sources of a download, in order, with what is known of them. Threads share it.

    A source that fails for ``patience`` files in a row is given up, and ``note`` gets a line about it. The number is
    above that of the threads: they all fail at once when a server has a bad second.
    """

    def __init__(self, sources: Sequence[Source], patience: int, note: Callable[[str], None]) -> None:
        self._sources = tuple(sources)
        self._patience = patience
        self._note = note
        self._strikes: Counter[Source] = Counter()
        self._delivered: Counter[Source] = Counter()
        self._said: dict[Source, str] = {}
        self._lock = threading.Lock()

    def usable(self) -> list[Source]:
        """Sources that have not been given up, in order."""
        with self._lock:
            return [source for source in self._sources if self._strikes[source] < self._patience]

    def given_up(self) -> dict[Source, str]:
        """Sources that have been given up, with what they said last."""
        usable = self.usable()
        return {source: self._said[source] for source in self._sources if source not in usable}

    def settle(self, winner: Source | None, failed: Mapping[Source, str]) -> None:
        """A file is done with: ``winner`` has delivered it, ``failed`` should have, and said why they could not."""
        skipped = []
        with self._lock:
            for source in failed.keys() - {winner}:
                self._strikes[source] += 1
                self._said[source] = failed[source]
                if self._strikes[source] == self._patience:
                    skipped.append(source)
            if winner is not None:
                self._delivered[winner] += 1
                self._strikes[winner] = 0
        for source in skipped:
            self._note(f"{source.label} keeps failing ({failed[source]}): it is not asked any more")

    def used(self) -> dict[str, int]:
        """Files that every source has delivered, by its label."""
        with self._lock:
            return {source.label: self._delivered[source] for source in self._sources if self._delivered[source]}


class Transfer:
    """The fetching of one file.

    ``advance`` gets the bytes by which the file grows, negative where bytes are thrown away; ``moved`` counts all that
    came from the sources. ``stop`` ends the transfer at the next chunk.
    """

    def __init__(
        self, entry: FileEntry, target: Path, mirrors: Mirrors, advance: Callable[[int], None], stop: threading.Event
    ) -> None:
        self.entry = entry
        self.target = target
        self.moved = 0
        self._mirrors = mirrors
        self._advance = advance
        self._stop = stop
        self._origins: set[Source | None] = set()
        self._corrupt = False

    def run(self) -> None:
        """Fetch the file; raises Undelivered, Stopped, or StorageError where the disk is full."""
        with closing(PartFile(self.target, self.entry.bytes)) as part:
            if part.position:
                self._origins.add(None)
                self._advance(part.position)
            if not self._finished(part):
                self._fetch(part)

    def _fetch(self, part: PartFile) -> None:
        """Pass over the sources until one has delivered."""
        answers = {source.label: f"given up: {why}" for source, why in self._mirrors.given_up().items()}
        failed: dict[Source, str] = {}
        sources = self._mirrors.usable()
        asked_s = 0.0
        for wait_s in WAITS_S:
            if not sources:
                break
            if self._stop.wait(max(wait_s, min(asked_s, LONGEST_WAIT_S))):
                raise Stopped
            asked_s = 0.0
            for source in tuple(sources):
                try:
                    self._take(part, source)
                except Refused as error:
                    sources.remove(source)
                    answers[source.label] = str(error)
                    if not error.absent:
                        failed[source] = str(error)
                except Faltered as error:
                    answers[source.label] = failed[source] = str(error)
                    asked_s = max(asked_s, error.wait_s)
                else:
                    self._mirrors.settle(source, failed)
                    return
        self._mirrors.settle(None, failed)
        self._raise_if_stopped()
        if not part.position:
            part.discard()
        raise Undelivered(self.entry, answers, self._corrupt)

    def _take(self, part: PartFile, source: Source) -> None:
        """The rest of the file from one source, in as many connections as bring it forward; or Refused or Faltered."""
        drops, began = 0, part.position
        while True:
            before = part.position
            try:
                self._stream(part, source)
            except Faltered:
                drops += 1
                if part.position == before or drops > DROPS + (part.position - began) // BYTES_PER_DROP:
                    raise
                continue
            whole_from_here = self._origins == {source}
            if self._finished(part):
                return
            if whole_from_here:
                self._corrupt = True
                raise Refused(f"sent other bytes than the release has (expected sha256 {self.entry.sha256[:12]}...)")

    def _stream(self, part: PartFile, source: Source) -> None:
        """One connection, from the next missing byte to the end."""
        self._raise_if_stopped()
        with source.open(self.entry.location, part.position, part.size) as (start, read):
            skip = part.position - start
            self._origins.add(source)
            while part.position < part.size:
                data = read(skip or part.size - part.position)
                self._raise_if_stopped()
                if not data:
                    raise Faltered(f"stopped after {part.position:,} of {part.size:,} bytes")
                self.moved += len(data)
                if skip:  # what is here already is passed over
                    skip -= len(data)
                else:
                    part.add(data)
                    self._advance(len(data))

    def _raise_if_stopped(self) -> None:
        if self._stop.is_set():
            raise Stopped

    def _finished(self, part: PartFile) -> bool:
        """Give a whole and right file its name; throw a whole and wrong one away."""
        if part.position < part.size:
            return False
        if part.matches(self.entry.sha256):
            part.finish()
            return True
        self._advance(-part.position)
        part.restart()
        self._origins.clear()
        return False
