"""Slippery, heavy, unbalanced objects."""

from __future__ import annotations

import math

from evaluator.scenarios.axes.base import Axis, Draw, varied
from evaluator.sim.parameters import WORLD
from rema_data.schema import TASKS, Scenario

__all__ = ["Physics"]


class Physics(Axis):
    """Less friction, more weight, and a centre of mass that no map shows."""

    name, number = "physics", 9
    title = (
        "friction of the objects, their density, and the target's centre of mass off its middle (share of its length)"
    )
    _levels = ((0.7, 2.0, 0.10), (0.5, 4.0, 0.20), (0.35, 6.0, 0.30))
    # two sticks hold few such objects, or none
    tasks = tuple(task for task, steps in TASKS.items() if not any(kind.embodiment.two_arms for kind in steps))
    levels = tuple(f"x {friction:g}, x {density:g}, {100 * off:.0f} %" for friction, density, off in _levels)

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        friction, density, off = self._levels[level - 1]
        world = {
            "object_friction": friction * WORLD.object_friction,
            "density_kg_m3": density * WORLD.density_kg_m3,
        }
        towards, far = float(draw.rng.uniform(0, 2 * math.pi)), off * scenario.placements[-1].spec.length_m / 2
        offset = (far * math.cos(towards), far * math.sin(towards))
        return varied(scenario, world=tuple(world.items()), mass_offset_m=offset)
