"""What a verification reports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["LISTED_OF_A_KIND", "Add", "Finding", "Findings", "Report", "rows_of"]

Add = Callable[[str, str, str, str], None]
"""Reports something in a block: kind, file inside the block, place in it, and detail."""

LISTED_OF_A_KIND = 20
"""So many findings of one kind are listed; further ones are counted."""
_NAMED = 5
"""So many rows are named in a finding."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong.

    Its kind is ``manifest``, ``missing``, ``size``, ``sha256``, ``unexpected``, ``table``, ``maps``, ``counts``,
    ``episodes``, ``labels``, ``actions``, ``numbers``, ``tools``, ``variations``, ``rows``, ``place`` or ``leakage``.
    """

    kind: str
    file: str  # path of the file
    where: str  # place in it: rows, or empty for the whole file
    detail: str
    fix: str  # the command or the edit that fixes it


@dataclass
class Findings:
    """Collects findings, at most ``LISTED_OF_A_KIND`` of each kind."""

    listed: list[Finding] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, file: str, detail: str, *, fix: str, where: str = "") -> None:
        """Report something."""
        self.counts[kind] += 1
        if self.counts[kind] <= LISTED_OF_A_KIND:
            self.listed.append(Finding(kind, file, where, detail, fix))


@dataclass(frozen=True)
class Report:
    """The result of a verification."""

    release: str
    sha256: str
    root: str  # the folder of releases in which it lies
    findings: Sequence[Finding]
    counts: dict[str, int]  # findings by kind, those that are not listed included
    checked: dict[str, int]  # how much was checked: blocks, files, bytes, episodes, steps, maps, frozen scenarios
    absent: Sequence[str] = ()  # blocks that have not been downloaded, and were not asked for
    unread: Sequence[str] = ()  # blocks whose contents could not be checked fully because of damaged files
    damaged: Sequence[str] = ()  # locations of files that do not have the bytes that were sealed

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.counts

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"ok": self.ok} | asdict(self)


def rows_of(bad: npt.NDArray[Any], start: int = 0) -> str:
    """Which rows are true in a boolean array whose first one is row ``start``: all of a few, else the first ones."""
    rows = np.flatnonzero(bad) + start
    named = ", ".join(str(row) for row in rows[:_NAMED])
    if len(rows) == 1:
        return f"row {named}"
    return f"{len(rows)} rows: {named}" + (", ..." if len(rows) > _NAMED else "")
