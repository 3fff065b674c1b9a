"""Success by what the episodes have in common: shapes, sizes, yaw, place; each with its count and its interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluator.run.run import Row, Run
from evaluator.scenarios.strata import strata
from evaluator.statistics import rate_interval
from rema_data import grid

__all__ = ["Breakdown", "Group", "PlaceMap", "breakdowns", "group", "place_map"]

PLACE_BINS = 7
"""Cells of the place map along an edge of the valid square."""
RINGS_M = (0.05, 0.10)
"""Distances from the middle at which places are divided."""
_TITLES = {
    "cell": "cell of the suite: axis and level",
    "shape": "shape of the target",
    "length": "length of the target's main bar",
    "width": "width of the target's bars",
    "yaw": "yaw of the target's main bar",
}
_HELD = {
    "tool0_shape": "shape of the first tool",
    "tool1_shape": "shape of the second tool",
    "pinch_shape": "shape of the pinched object",
}


@dataclass(frozen=True, slots=True)
class Group:
    """Some measured episodes; ``low`` and ``high`` are the 95 % interval of their rate, shares in 0..1."""

    label: str
    n: int
    successes: int
    low: float
    high: float

    @property
    def rate(self) -> float:
        """Share of successes; there is at least one episode."""
        return self.successes / self.n


@dataclass(frozen=True, slots=True)
class Breakdown:
    """Episodes divided by one property; two groups at least, those without episodes are left out."""

    title: str
    groups: tuple[Group, ...]

    @property
    def reference(self) -> float:
        """Rate of all these episodes."""
        return sum(group.successes for group in self.groups) / sum(group.n for group in self.groups)


@dataclass(frozen=True, slots=True)
class PlaceMap:
    """Success by where the target lay."""

    # (column, row, group): column 0 at the smallest x, row 0 at the largest y, as drawn
    cells: tuple[tuple[int, int, Group], ...]
    bins: int  # cells along an edge
    half_m: float  # half an edge of the whole map


def group(label: str, rows: Sequence[Row]) -> Group:
    """The group of some measured episodes, at least one."""
    successes = sum(row["success"] for row in rows)
    return Group(label, len(rows), successes, *rate_interval(successes, len(rows)))


def reached(run: Run) -> list[Row]:
    """Measured episodes that reached the last step: those in which the target decided anything."""
    last = f"step{run.steps[-1]}_success"
    return [row for row in run.measured if row[last] is not None]


def breakdowns(run: Run) -> list[Breakdown]:
    """Success by shape, size, yaw and place of the target, and by the shapes of what was held.

    Properties of the target are about the episodes that reached the last step; those of tools about all measured ones.
    """
    rows = {row["index"]: row for row in reached(run)}
    by: dict[str, list[Group]] = {}
    for stratum in strata(run.targets):
        members = [rows[index] for index in np.flatnonzero(stratum.members).tolist() if index in rows]
        if members:
            by.setdefault(stratum.by, []).append(group(stratum.label, members))
    found = [Breakdown(_TITLES.get(name, name), tuple(groups)) for name, groups in by.items()]
    found.append(Breakdown("distance of the target from the middle", tuple(_rings(list(rows.values())))))
    for column, title in _HELD.items():
        shapes = sorted({row[column] for row in run.measured if row.get(column)})
        groups = (group(shape, [row for row in run.measured if row[column] == shape]) for shape in shapes)
        found.append(Breakdown(title, tuple(groups)))
    return [breakdown for breakdown in found if len(breakdown.groups) > 1]


def _rings(rows: Sequence[Row]) -> list[Group]:
    labels = [f"up to {RINGS_M[0] * 100:g} cm", f"{RINGS_M[0] * 100:g} to {RINGS_M[1] * 100:g} cm"]
    labels.append(f"more than {RINGS_M[1] * 100:g} cm")
    rings: list[list[Row]] = [[] for _ in labels]
    for row in rows:
        distance = math.hypot(row["target_x_m"], row["target_y_m"])
        rings[sum(distance > edge for edge in RINGS_M)].append(row)
    return [group(label, ring) for label, ring in zip(labels, rings, strict=True) if ring]


def place_map(run: Run) -> PlaceMap | None:
    """Success by the place of the target, over the valid square; None where no episode reached the last step."""
    half = grid.SCENE_HALF_M - grid.VALID_MARGIN * grid.PIXEL_M
    cells: dict[tuple[int, int], list[Row]] = {}
    for row in reached(run):
        x, y = (
            min(PLACE_BINS - 1, max(0, math.floor((row[name] + half) / (2 * half) * PLACE_BINS)))
            for name in ("target_x_m", "target_y_m")
        )
        cells.setdefault((PLACE_BINS - 1 - y, x), []).append(row)
    if not cells:
        return None
    size_cm = 2 * half / PLACE_BINS * 100
    named = []
    for (down, across), rows in sorted(cells.items()):
        left, top = across * size_cm - half * 100, half * 100 - down * size_cm
        label = f"x {left:.1f} to {left + size_cm:.1f} cm, y {top - size_cm:.1f} to {top:.1f} cm"
        named.append((across, down, group(label, rows)))
    return PlaceMap(tuple(named), PLACE_BINS, half)
