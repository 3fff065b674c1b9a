"""Other tools in the hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from evaluator.scenarios.axes.base import Axis, Draw
from evaluator.scenarios.axes.objects import reshaped
from evaluator.sim.parameters import WORLD
from rema_data.schema import TASKS, Grip, ObjectSpec, Pinch, Placement, Scenario, Shape, Situation, tool_steps

if TYPE_CHECKING:
    from evaluator.sim.simulator import Simulator

__all__ = ["Tools"]

_TRIES = 20
Change = Callable[[ObjectSpec, np.random.Generator], ObjectSpec]


def _one_of(*shapes: Shape) -> Change:
    return lambda spec, rng: reshaped(spec, shapes[int(rng.integers(len(shapes)))])


def _stick(length: tuple[float, float], width: tuple[float, float]) -> Change:
    return lambda spec, rng: ObjectSpec(
        Shape.I, float(rng.uniform(*length)), float(rng.uniform(*width)), 0.0, spec.height_m
    )


_USUAL = (WORLD.stick_width_min_m, WORLD.stick_width_max_m)
_ONE_HAND: tuple[Change, ...] = (
    _one_of(Shape.U, Shape.Z, Shape.PLUS),
    _one_of(Shape.HOOK, Shape.RAKE),
    _stick((WORLD.stick_length_min_m, WORLD.stick_length_max_m), _USUAL),
)
_TWO_HANDS: tuple[Change, ...] = (
    _stick((0.165, 0.180), _USUAL),
    _stick((0.205, 0.225), _USUAL),
    _stick((WORLD.stick_length_min_m, WORLD.stick_length_max_m), (0.035, 0.045)),
)


class Tools(Axis):
    """Tools of other shapes and sizes, picked by the reference policy where there is a simulator."""

    name, number = "tool", 4
    title = "other tools in the hand (two arms: other sticks), picked by the reference policy"
    levels = (
        "U, Z, plus; two arms: sticks of 165 to 180 mm",
        "hook, rake; two arms: sticks of 205 to 225 mm",
        "sticks of 180 to 205 mm; two arms: sticks 35 to 45 mm wide",
    )
    tasks = tuple(task for task in TASKS if tool_steps(task))

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario | None:
        task, steps = scenario.task, TASKS[scenario.task]
        two_arms = any(kind.embodiment.two_arms for kind in steps)
        change = (_TWO_HANDS if two_arms else _ONE_HAND)[level - 1]
        placements = list(scenario.placements)
        grips: tuple[Grip, ...] = ()
        pinch: Pinch | None = None
        for step, kind in enumerate(steps[:-1]):
            if kind.makes == "tool":
                placements[step] = dataclasses.replace(placements[step], spec=change(placements[step].spec, draw.rng))
            if draw.simulator is None:
                continue
            made = self._made(Situation(task, step, placements[step], grips), draw.simulator, draw.rng)
            if isinstance(made, Grip):
                grips = (*grips, made)
            elif isinstance(made, Pinch):
                pinch = made
            else:
                return None
        return dataclasses.replace(scenario, placements=tuple(placements), grips=grips, pinch=pinch)

    def _made(self, situation: Situation, simulator: Simulator, rng: np.random.Generator) -> Grip | Pinch | None:
        from evaluator.sim.reference import reference_step  # needs PyBullet, which the names of the axes do not

        for _ in range(_TRIES):
            if (done := reference_step(simulator, situation, rng)) is not None:
                return done.grip or done.pinch
            turn = float(rng.uniform(0, 2 * np.pi))
            target: Placement = dataclasses.replace(situation.target, yaw_rad=turn)
            situation = dataclasses.replace(situation, target=target)
        return None
