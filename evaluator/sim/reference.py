"""The privileged reference policy: tools as they come into the hands of the frozen scenarios.

A reference pick or pinch knows where the object is, chooses from the candidates of its kind of step, and is an ordinary
action on the grid, carried out by the simulator: what it leaves in the hand is what a good policy would get. In later
versions of the scenario lists a learned policy picks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np

from evaluator.sim.kinds import kind_of
from evaluator.sim.reach import valid_actions
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import draw_episode, draw_step
from rema_data.schema import TASKS, Grip, Pinch, Placement, Scenario, Situation, StepOutcome

__all__ = ["Prepared", "prepare", "reference_step"]

TRIES = 6


@dataclass(frozen=True, slots=True)
class Prepared:
    """An episode up to its last step: its objects, the tools in hand, and how many objects were drawn again."""

    placements: tuple[Placement, ...]
    grips: tuple[Grip, ...]
    pinch: Pinch | None
    redrawn: int

    def scenario(self, task: str, split: str = "", index: int = 0) -> Scenario:
        """The episode as a scenario."""
        return Scenario(task, split, index, self.placements, self.grips, self.pinch)


def prepare(simulator: Simulator, task: str, rng: np.random.Generator) -> Prepared:
    """Draw an episode and put its tools into the hands; an object that cannot be picked or pinched is drawn again."""
    placements = list(draw_episode(rng, task, simulator.parameters))
    grips: tuple[Grip, ...] = ()
    pinch: Pinch | None = None
    redrawn = 0
    for step, kind in enumerate(TASKS[task][:-1]):
        if kind.makes is None:
            continue
        while True:
            done = reference_step(simulator, Situation(task, step, placements[step], grips), rng)
            if done is not None:
                break
            placements[step] = draw_step(rng, task, step, simulator.parameters)
            redrawn += 1
        grips = grips if done.grip is None else (*grips, done.grip)
        pinch = done.pinch
    return Prepared(tuple(placements), grips, pinch, redrawn)


def reference_step(simulator: Simulator, situation: Situation, rng: np.random.Generator) -> StepOutcome | None:
    """Pick up or pinch, at random along the bar, an object that is to become a tool; None if no try succeeds."""
    valid = valid_actions(situation.task, situation.step).reshape(-1)
    candidates = kind_of(situation).candidates(situation.target, valid, rng, simulator.parameters)
    for action in islice(candidates, TRIES):
        outcome = simulator.run(situation, action)
        if outcome.success:
            return outcome
    return None
