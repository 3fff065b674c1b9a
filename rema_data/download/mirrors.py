"""Which source is asked for a file, and which ones have failed so often that they are asked no more."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from rema_data.download.sources import Source

__all__ = ["Mirrors"]


class Mirrors:
    """The sources of a download, in order, with what is known of them. Threads share it.

    Parameters
    ----------
    sources : sequence of Source
    patience : int
        A source that fails for so many files in a row is given up. More than the number of threads: they all fail at
        once when a server has a bad second.
    note : callable
        Gets a line about a source that is given up.
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
        with self._lock:
            return {source: self._said[source] for source in self._sources if self._strikes[source] >= self._patience}

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
