"""Targets of other shapes, and of other sizes."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from evaluator.scenarios.axes.base import Axis, Draw, with_target
from evaluator.sim.parameters import WORLD
from rema_data.schema import ObjectSpec, Scenario, Shape

__all__ = ["Shapes", "Sizes", "reshaped"]

_WIDEST = 0.22
"""Widest bar of a shape with an inside, as a share of its length."""


def reshaped(spec: ObjectSpec, shape: Shape) -> ObjectSpec:
    """An object of another shape, as long, with bars as wide as the shape leaves room for."""
    width = spec.width_m if shape in (Shape.PLUS, Shape.Z) else min(spec.width_m, _WIDEST * spec.length_m)
    return ObjectSpec(shape, spec.length_m, width, WORLD.arm_ratio * spec.length_m, spec.height_m)


class Shapes(Axis):
    """Shapes that no release has."""

    name, number = "shape", 1
    title = "targets of shapes that no release has"
    groups = ((Shape.U, Shape.Z, Shape.PLUS), (Shape.Y, Shape.RING, Shape.H), (Shape.COMB, Shape.EIGHT, Shape.F))
    levels = tuple(", ".join(shape.value for shape in group) for group in groups)

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        target, group = scenario.placements[-1], self.groups[level - 1]
        spec = reshaped(target.spec, group[int(draw.rng.integers(len(group)))])
        return with_target(scenario, dataclasses.replace(target, spec=spec))


class Sizes(Axis):
    """The training shapes outside of their training sizes."""

    name, number = "size", 2
    title = "targets outside of the training sizes (70 to 130 mm long, 20 to 45 mm wide, 30 mm high)"
    levels = ("50 to 70 mm wide", "140 to 190 mm long", "75 to 95 mm wide", "15 mm high", "45 mm high")
    left_out: ClassVar = {"grasp_grasp": (1, 3)}  # sticks lift few of the wide ones, or none
    _widths: ClassVar = {1: (0.050, 0.070), 3: (0.075, 0.095)}
    _heights: ClassVar = {4: 0.015, 5: 0.045}

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        target = scenario.placements[-1]
        spec = target.spec
        if level in self._widths:  # a second bar keeps its reach beyond the main one
            width = float(draw.rng.uniform(*self._widths[level]))
            arm = spec.arm_m and max(spec.arm_m, width + 0.02)
            spec = dataclasses.replace(spec, width_m=width, length_m=max(spec.length_m, width), arm_m=arm)
        elif level in self._heights:
            spec = dataclasses.replace(spec, height_m=self._heights[level])
        else:
            length = float(draw.rng.uniform(0.140, 0.190))
            spec = dataclasses.replace(spec, length_m=length, arm_m=spec.arm_m and WORLD.arm_ratio * length)
        return with_target(scenario, dataclasses.replace(target, spec=spec))
