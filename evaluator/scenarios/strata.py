"""Scenarios by shape, size and yaw of their target: to explore where a policy fails, not to rank."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evaluator.scenarios import load_list
from rema_data.schema import Shape

__all__ = ["Stratum", "Targets", "strata", "targets_of_list"]

QUARTILES = (0.25, 0.5, 0.75)
YAW_BINS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """The objects that the last step is about, scenario by scenario; arrays (N,)."""

    shape: npt.NDArray[np.str_]
    length_m: npt.NDArray[np.float64]  # of the main bar, as the next two
    width_m: npt.NDArray[np.float64]
    yaw_rad: npt.NDArray[np.float64]  # in the world frame
    cell: npt.NDArray[np.str_] | None = None  # of a suite, in words; None for clean scenarios

    def first(self, count: int) -> Targets:
        """The first so many."""
        numbers = self.length_m[:count], self.width_m[:count], self.yaw_rad[:count]
        return Targets(self.shape[:count], *numbers, None if self.cell is None else self.cell[:count])


@dataclass(frozen=True, slots=True, eq=False)
class Stratum:
    """Scenarios that share something."""

    by: str  # cell (of a suite), shape, length, width or yaw
    label: str  # with units
    members: npt.NDArray[np.bool_]  # (N,)


def targets_of_list(task: str, split: str, version: str | None = None) -> Targets:
    """Targets of a frozen list; arguments and errors are those of ``load_list``."""
    scenarios = load_list(task, split, version).scenarios
    placed = [scenario.placements[-1] for scenario in scenarios]
    rows = ((one.spec.shape.value, one.spec.length_m, one.spec.width_m, one.yaw_rad) for one in placed)
    shape, length, width, yaw = map(np.array, zip(*rows, strict=True))
    cells = [one.variation.cell for one in scenarios if one.variation is not None]
    return Targets(shape, length, width, yaw, np.array(cells) if cells else None)


def strata(targets: Targets) -> list[Stratum]:
    """Every stratum that has a scenario: shapes, quartiles of length and width, and eight directions of yaw.

    Quartiles are those of ``targets``: equal for all policies on one list.
    """
    return [stratum for stratum in _all(targets) if stratum.members.any()]


def _all(targets: Targets) -> Iterator[Stratum]:
    if targets.cell is not None:
        for cell in np.unique(targets.cell).tolist():
            yield Stratum("cell", cell, targets.cell == cell)
    for shape in Shape:
        yield Stratum("shape", shape.value, targets.shape == shape.value)
    yield from _quarters("length", targets.length_m)
    yield from _quarters("width", targets.width_m)
    width = 2 * math.pi / YAW_BINS
    places = np.rint(targets.yaw_rad / width).astype(int) % YAW_BINS
    for place in range(YAW_BINS):
        yield Stratum("yaw", f"{place * 360 // YAW_BINS} ± {180 / YAW_BINS:g} deg", places == place)


def _quarters(by: str, values_m: npt.NDArray[np.float64]) -> Iterator[Stratum]:
    edges = np.quantile(values_m, QUARTILES) if len(values_m) else np.zeros(len(QUARTILES))
    places = np.searchsorted(edges, values_m, side="right")
    for place in range(len(QUARTILES) + 1):
        members = places == place
        if members.any():
            inside = 1e3 * values_m[members]
            yield Stratum(by, f"{inside.min():.0f} to {inside.max():.0f} mm", members)
