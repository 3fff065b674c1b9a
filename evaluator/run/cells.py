"""The score of a run over a suite: rates of cells, means of axes, and ``hard``, the mean of the axes.

An axis is the mean of its levels, ``hard`` the mean of its axes: each counts the same, whatever its rate. Where a
scenario lacks, there is no mean, never that of what happens to be there. Intervals are those of a bootstrap over clean
scenarios, since the levels of an axis share them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evaluator.run.plan import find_list
from evaluator.run.run import Run
from evaluator.scenarios.axes import AXES
from evaluator.scenarios.suite import cells_of
from rema_data.errors import InputError

__all__ = ["AxisScore", "CellScore", "SuiteScore", "score"]

RESAMPLES = 10_000
_LEVELS = (2.5, 97.5)


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
    def worst(self) -> AxisScore | None:
        """The axis with the lowest mean, of those that count."""
        return min(
            (axis for axis in self.axes if axis.counts and axis.mean is not None),
            key=lambda axis: axis.mean or 0.0,
            default=None,
        )


def score(run: Run, *, seed: int = 0) -> SuiteScore:
    """The score of a run over a suite; InputError for a run over clean scenarios."""
    listed = find_list(run.task, run.split, run.provenance.scenarios_hash, run.outcomes.eligible.size)
    cells = cells_of(listed)
    if not cells:
        raise InputError(f"{run.source} was not played over a suite", hint="rema evaluate POLICY --suite hard-v1")
    base = np.array([one.variation.base if one.variation else -1 for one in listed.scenarios])
    success, measured = np.zeros(len(base), bool), np.zeros(len(base), bool)
    played = run.outcomes.eligible.size
    success[:played], measured[:played] = run.outcomes.success, run.outcomes.eligible
    rng = np.random.default_rng(seed)
    axes: list[AxisScore] = []
    drawn: list[npt.NDArray[np.float64]] = []
    for name in dict.fromkeys(cell.axis for cell in cells):
        own = {cell.level: np.array(rows) for cell, rows in cells.items() if cell.axis == name}
        scores = tuple(
            CellScore(level, int((success & measured)[rows].sum()), int(measured[rows].sum()), len(rows))
            for level, rows in own.items()
        )
        mean, means = None, None
        if all(one.rate is not None for one in scores):
            mean = float(np.mean([one.rate for one in scores]))
            by_base = np.mean([success[rows[np.argsort(base[rows])]] for rows in own.values()], axis=0)
            means = by_base[rng.integers(len(by_base), size=(RESAMPLES, len(by_base)))].mean(axis=1)
            if AXES[name].counts:
                drawn.append(means)
        axes.append(AxisScore(name, AXES[name].counts, scores, mean, _interval(means)))
    counting = [axis.mean for axis in axes if axis.counts]
    whole = all(mean is not None for mean in counting)
    return SuiteScore(
        listed.version,
        run.task,
        tuple(axes),
        float(np.mean([mean for mean in counting if mean is not None])) if whole else None,
        _interval(np.mean(drawn, axis=0)) if whole else None,
    )


def _interval(means: npt.NDArray[np.float64] | None) -> tuple[float, float] | None:
    if means is None:
        return None
    low, high = np.percentile(means, _LEVELS)
    return float(low), float(high)
