"""Further loose objects on the table."""

from __future__ import annotations

from evaluator.scenarios.axes.base import Axis, Draw, varied
from evaluator.sim.planar import gap
from evaluator.sim.shapes import footprint
from evaluator.sim.spawn import draw_placement
from rema_data.schema import Placement, Scenario

__all__ = ["Clutter", "beside"]

_COUNTS = (1, 2, 4)
_ROOM_M = 0.004
_TRIES = 200


class Clutter(Axis):
    """Loose objects of the training shapes beside the target; lifting any one of them, alone, is a grasp."""

    name, number = "clutter", 0
    title = "further loose objects; lifting any one, alone, counts"
    levels = tuple(f"{count} further object{'s' * (count > 1)}" for count in _COUNTS)
    tasks = ("grasp",)

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario | None:
        kind = scenario.last_situation().kind
        others: list[Placement] = []
        for _ in range(_TRIES):
            one = draw_placement(draw.rng, kind, stick=False)
            if beside(one, (scenario.placements[-1], *others)):
                others.append(one)
            if len(others) == _COUNTS[level - 1]:
                return varied(scenario, others=tuple(others))
        return None


def beside(one: Placement, others: tuple[Placement, ...], room_m: float = _ROOM_M) -> bool:
    """Whether an object stands clear of others."""
    return all(gap(footprint(one), footprint(other)) > room_m for other in others)
