"""Progress of anything that takes more than a moment: one protocol for all work and for all that shows it."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Progress", "Silent"]


class Progress(Protocol):
    """Where work reports how far it is. Its methods are called by one thread at a time."""

    def phase(self, name: str, total: int) -> None:
        """A phase of ``total`` items (or bytes) begins."""
        return

    def advance(self, n: int) -> None:
        """``n`` more items of the present phase are done; negative where work was lost."""
        return

    def resume(self, n: int) -> None:
        """``n`` items of the present phase were done by an earlier process: they do not count in its speed."""
        return

    def tell(self, detail: str) -> None:
        """The state of the present phase in a few words, shown beside its bar."""
        return

    def note(self, text: str) -> None:
        """A message worth a line of its own."""
        return


class Silent(Progress):
    """Progress that shows nothing."""
