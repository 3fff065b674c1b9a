"""Scenario lists whose tools a policy picked, instead of the reference policy.

The same generators draw the objects of both lists. An object that the policy fails to pick is drawn again. A pinch
(``grasp_grasp_push``) is still that of the reference policy; where it fails on many objects, the tools are drawn and
picked again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from evaluator.sim.reference import reference_step
from evaluator.sim.simulator import process_simulator
from evaluator.sim.spawn import draw_episode, draw_step
from rema_data.errors import PolicyFailureError
from rema_data.schema import Grip, Pinch, Placement, Scenario, Situation, StepOutcome, pinch_step, tool_steps

__all__ = ["Picked", "Picker", "draw_picked"]

LIMIT = 200
"""Objects that are drawn for one tool at most: a policy that cannot pick is an error, not a long wait."""


@dataclass(frozen=True, slots=True)
class Picker:
    """A policy that picks the tools of a list, with the name and digest that the manifest records.

    ``carry_out`` maps situations of one step to the outcomes of the policy's actions, in order. It raises
    ``PolicyFailureError`` where the policy gives no action.
    """

    name: str
    digest: str
    carry_out: Callable[[Sequence[Situation]], list[StepOutcome]]


@dataclass(slots=True)
class Picked:
    """A scenario that is being drawn, and the number of objects that were drawn again for it."""

    index: int
    rng: np.random.Generator
    placements: list[Placement]
    grips: tuple[Grip, ...] = ()
    pinch: Pinch | None = None
    redrawn: int = 0

    def start_over(self, task: str) -> None:
        """Draw all objects again, for empty hands."""
        self.placements, self.grips, self.pinch = list(draw_episode(self.rng, task)), (), None
        self.redrawn += len(self.placements)

    def scenario(self, task: str, split: str) -> Scenario:
        """The finished scenario."""
        return Scenario(task, split, self.index, tuple(self.placements), self.grips, self.pinch)


def draw_picked(
    task: str,
    generators: dict[int, np.random.Generator],
    picker: Picker,
    pool: Executor,
) -> list[Picked]:
    """Draw some scenarios of a task, in the order of their indices; a function of the indices and the policy alone.

    ``generators`` are by index; ``pool`` runs the reference pinches. Raises PolicyFailureError where the policy gave no
    action, or failed on too many objects in a row.
    """
    drawn = [Picked(index, rng, list(draw_episode(rng, task))) for index, rng in sorted(generators.items())]
    waiting = drawn
    for _ in range(LIMIT):
        for step in tool_steps(task):
            if failed := _failed(waiting, partial(_pick, task, step, picker), task, step):
                raise _cannot(task, step, failed[0], "draw the lists with a policy that can pick tools")
        pinched = pinch_step(task)
        if pinched is None:
            return drawn
        step = pinched
        waiting = _failed(waiting, partial(_pinch, task, step, pool), task, step)
        if not waiting:
            return drawn
        for one in waiting:  # the tools lie in the hands in such a way that nothing can be pinched between them
            one.start_over(task)
    raise _cannot(task, step, waiting[0], "draw the lists with a policy whose picks leave the tools free")


def _failed(
    drawn: Sequence[Picked], attempt: Callable[[list[Picked]], list[bool]], task: str, step: int
) -> list[Picked]:
    """Try every scenario's object, and draw those that failed again; the scenarios that failed on ``LIMIT`` of them."""
    waiting = list(drawn)
    for _ in range(LIMIT):
        won = attempt(waiting)
        waiting = [one for one, good in zip(waiting, won, strict=True) if not good]
        if not waiting:
            break
        for one in waiting:
            one.placements[step] = draw_step(one.rng, task, step)
            one.redrawn += 1
    return waiting


def _cannot(task: str, step: int, one: Picked, hint: str) -> PolicyFailureError:
    return PolicyFailureError(
        f"step {step} of {task} failed on {LIMIT} objects in a row for scenario {one.index}",
        hint=hint,
        task=task,
        step=step,
    )


def _pick(task: str, step: int, picker: Picker, some: list[Picked]) -> list[bool]:
    outcomes = picker.carry_out([Situation(task, step, one.placements[step], one.grips) for one in some])
    for one, outcome in zip(some, outcomes, strict=True):
        if outcome.success and outcome.grip is not None:
            one.grips = (*one.grips, outcome.grip)
    return [outcome.success for outcome in outcomes]


def _pinch_one(situation: Situation, rng: np.random.Generator) -> Pinch | None:
    """In a worker of the pool."""
    outcome = reference_step(process_simulator(), situation, rng)
    return None if outcome is None else outcome.pinch


def _pinch(task: str, step: int, pool: Executor, some: list[Picked]) -> list[bool]:
    situations = [Situation(task, step, one.placements[step], one.grips) for one in some]
    pinches = pool.map(_pinch_one, situations, [one.rng for one in some], chunksize=25)
    for one, pinch in zip(some, pinches, strict=True):
        one.pinch = pinch
    return [one.pinch is not None for one in some]
