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

    Attributes
    ----------
    kind : str
        What sort of thing: ``manifest``, ``missing``, ``size``, ``sha256``, ``unexpected``, ``table``, ``maps``,
        ``counts``, ``episodes``, ``labels``, ``actions``, ``numbers``, ``tools``, ``rows``, ``place``, ``leakage``.
    file : str
        Path of the file.
    where : str
        Place in it: rows, or empty for the whole file.
    detail : str
    fix : str
        The command or the edit that fixes it.
    """

    kind: str
    file: str
    where: str
    detail: str
    fix: str


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
    """The result of a verification.

    Attributes
    ----------
    release, sha256, root : str
        Name, identity, and the folder of releases in which it lies.
    findings : sequence of Finding
    counts : dict of str to int
        Findings by kind, those that are not listed included.
    checked : dict of str to int
        How much was looked at: blocks, files, bytes, episodes, steps, maps, frozen scenarios.
    absent : sequence of str
        Blocks that have not been downloaded, and were not asked for.
    unread : sequence of str
        Blocks whose contents could not be checked fully because of damaged files.
    damaged : sequence of str
        Locations of files that are there, or should be, and do not have the bytes that were sealed.
    """

    release: str
    sha256: str
    root: str
    findings: Sequence[Finding]
    counts: dict[str, int]
    checked: dict[str, int]
    absent: Sequence[str] = ()
    unread: Sequence[str] = ()
    damaged: Sequence[str] = ()

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
