"""The score of a run over a suite: rates of cells, means of axes, and ``hard``, the mean of the axes.

An axis is the mean of its levels, ``hard`` the mean of its axes: each counts the same, whatever its rate. Where a
scenario lacks, there is no mean, never that of what happens to be there. Intervals are those of a bootstrap over clean
scenarios, since the levels of an axis share them; exact ones at 0 and 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from evaluator.run.plan import find_list
from evaluator.run.run import Run
from evaluator.scenarios.axes import AXES
from evaluator.scenarios.suites import Cell, cells_of
from evaluator.statistics import clopper_pearson
from rema_data.errors import InputError
from rema_data.schema import Failure

__all__ = ["AxisScore", "CellScore", "Solved", "SuiteScore", "errors_by_axis", "score", "score_of", "solved"]

RESAMPLES = 10_000
_LEVELS = (2.5, 97.5)
_SEED = 0
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CellScore:
    """One axis at one level."""

    level: int
    successes: int
    measured: int  # finished scenarios, infrastructure errors aside
    of: int  # scenarios of the cell

    @property
    def rate(self) -> float | None:
        """Share of successes of a whole cell."""
        return self.successes / self.of if self.measured == self.of else None


@dataclass(frozen=True, slots=True)
class AxisScore:
    """The levels of an axis and their mean, with its 95 % interval; null where a scenario lacks."""

    name: str
    counts: bool  # whether it is one of those whose mean is ``hard``
    cells: tuple[CellScore, ...]
    mean: float | None
    interval: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class SuiteScore:
    """The score of a run in one task."""

    suite: str
    task: str
    axes: tuple[AxisScore, ...]
    hard: float | None
    interval: tuple[float, float] | None

    @property
    def lacking(self) -> list[str]:
        """Axes and levels that lack a scenario that the mean needs, such as ``clutter 2 (12 of 500)``."""
        return [
            f"{axis.name} {cell.level} ({cell.measured:,} of {cell.of:,})"
            for axis in self.axes
            if axis.counts
            for cell in axis.cells
            if cell.measured < cell.of
        ]

    @property
    def worst(self) -> AxisScore | None:
        """The axis with the lowest mean, of those that count."""
        found = [axis for axis in self.axes if axis.counts and axis.mean is not None]
        return min(found, key=lambda axis: axis.mean or 0.0, default=None)


@dataclass(frozen=True, eq=False)
class Solved:
    """What a run solved of a suite: by axis, the share of the levels solved for every clean scenario; or None."""

    axes: dict[str, Floats | None]

    @property
    def whole(self) -> bool:
        """Whether every scenario of the axes that count was measured."""
        return all(self.axes[name] is not None for name in self.counting)

    @property
    def counting(self) -> list[str]:
        """The axes whose mean is ``hard``."""
        return [name for name in self.axes if AXES[name].counts]

    def drawn_again(self, name: str, rng: np.random.Generator) -> Floats:
        """Means of an axis over clean scenarios that are drawn again, float (resamples,)."""
        shares = self.axes[name]
        assert shares is not None
        means: Floats = shares[rng.integers(len(shares), size=(RESAMPLES, len(shares)))].mean(axis=1)
        return means

    @property
    def every(self) -> Floats:
        """The shares of all axes that count, one after the other: each axis has clean scenarios of its own."""
        return np.concatenate([shares for name in self.counting if (shares := self.axes[name]) is not None])

    @cached_property
    def hard_again(self) -> Floats:
        """``hard`` over clean scenarios that are drawn again: the same ones for every run."""
        rng = np.random.default_rng(_SEED)
        means: Floats = np.mean([self.drawn_again(name, rng) for name in self.counting], axis=0)
        return means


def solved(run: Run) -> tuple[Solved, dict[Cell, CellScore], str]:
    """What a run solved, the counts of every cell, and the suite; InputError for a run over clean scenarios."""
    success, measured = run.outcomes.success, run.outcomes.eligible
    listed = find_list(run.task, run.split, run.provenance.scenarios_hash, measured.size)
    cells = cells_of(listed)
    if not cells:
        raise InputError(f"{run.source} was not played over a suite", hint="rema evaluate POLICY --suite hard-v1")
    beyond = np.zeros(len(listed.scenarios) - measured.size, bool)  # scenarios that a short run did not play
    success, measured = np.append(success & measured, beyond), np.append(measured, beyond)
    base = np.array([one.variation.base if one.variation else -1 for one in listed.scenarios])
    counts = {
        cell: CellScore(cell.level, int(success[rows].sum()), int(measured[rows].sum()), len(rows))
        for cell, rows in cells.items()
    }
    axes: dict[str, Floats | None] = {}
    for name in dict.fromkeys(cell.axis for cell in cells):
        own = [np.array(rows) for cell, rows in cells.items() if cell.axis == name]
        whole = all(measured[rows].all() for rows in own)
        axes[name] = np.mean([success[rows[np.argsort(base[rows])]] for rows in own], axis=0) if whole else None
    return Solved(axes), counts, listed.version


def score(run: Run) -> SuiteScore:
    """The score of a run over a suite; InputError for a run over clean scenarios."""
    return score_of(run.task, *solved(run))


def score_of(task: str, found: Solved, counts: dict[Cell, CellScore], suite: str) -> SuiteScore:
    """The score of what ``solved`` found in a task."""
    rng = np.random.default_rng(_SEED)
    axes = tuple(
        AxisScore(
            name,
            AXES[name].counts,
            tuple(one for cell, one in counts.items() if cell.axis == name),
            None if shares is None else float(shares.mean()),
            None if shares is None else _interval(found.drawn_again(name, rng), shares),
        )
        for name, shares in found.axes.items()
    )
    if not found.whole:
        return SuiteScore(suite, task, axes, None, None)
    hard = float(np.mean([axis.mean for axis in axes if axis.counts]))  # type: ignore[arg-type]
    return SuiteScore(suite, task, axes, hard, _interval(found.hard_again, found.every))


def errors_by_axis(run: Run) -> dict[str, tuple[int, int]]:
    """Policy errors of a run folder over a suite, and its scenarios, by axis; without the axes that had no error."""
    failed = np.array([label == Failure.POLICY_ERROR.value for label in run.table["failure"].to_pylist()])
    found: dict[str, tuple[int, int]] = {}
    for cell, rows in cells_of(find_list(run.task, run.split, run.provenance.scenarios_hash, failed.size)).items():
        played = [row for row in rows if row < failed.size]
        errors, of = found.get(cell.axis, (0, 0))
        found[cell.axis] = errors + int(failed[played].sum()), of + len(played)
    return {axis: counts for axis, counts in found.items() if counts[0]}


def _interval(means: Floats, shares: Floats) -> tuple[float, float]:
    """Of the bootstrap; where nothing or everything was solved it would have no width, and the exact one is given.

    That one counts clean scenarios: an axis is at 1 where all of its levels were solved for every one of them.
    """
    if shares.min() == shares.max() in (0.0, 1.0):
        return clopper_pearson(int(shares.sum()), shares.size)
    low, high = np.percentile(means, _LEVELS)
    return float(low), float(high)
