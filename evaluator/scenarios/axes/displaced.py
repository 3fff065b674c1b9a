"""Maps beside the world, and hands beside their goal."""

from __future__ import annotations

import math

from evaluator.scenarios.axes.base import Axis, Draw, varied
from rema_data.schema import Scenario
from rema_data.variation import Displacement

__all__ = ["Act", "Register"]


class Register(Axis):
    """A constant error between map and world: the same size in every scenario of a level, in any direction."""

    name, number = "register", 7
    title = "a constant error between map and world"
    _levels = ((0.002, 1.0), (0.005, 3.0), (0.009, 6.0))
    levels = tuple(f"{1000 * far:g} mm, {turn:g} degrees" for far, turn in _levels)
    noisy = True

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        far, turn = self._levels[level - 1]
        towards, sign = float(draw.rng.uniform(0, 2 * math.pi)), float(draw.rng.choice([-1.0, 1.0]))
        error = Displacement(far * math.cos(towards), far * math.sin(towards), sign * math.radians(turn))
        return varied(scenario, register=error)


class Act(Axis):
    """An error of the hand when it acts."""

    name, number = "act", 8
    title = "an error of the hand when it acts: standard deviation along each axis, and of its angle"
    _levels = ((0.003, 2.0), (0.006, 5.0), (0.012, 10.0))
    levels = tuple(f"{1000 * far:g} mm, {turn:g} degrees" for far, turn in _levels)
    noisy = True

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        far, turn = self._levels[level - 1]
        x, y, yaw = (float(value) for value in draw.rng.standard_normal(3))
        return varied(scenario, act=Displacement(far * x, far * y, math.radians(turn) * yaw))
