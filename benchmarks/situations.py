"""Cases to measure with: situations of the ``calibrate`` seed domain, and the actions of simple policies for them.

No frozen scenario and no collected episode shares these seeds. Tools are picked up by the privileged reference pick.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.scripted_policy import nearest_valid
from evaluator.sim.kinds import kind_of
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.reach import reachable
from evaluator.sim.reference import reference_step
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import draw_episode, episode_generator
from rema_data import grid
from rema_data.schema import Scenario, Situation, StepKind

ROOT_SEED = 20211202
"""Other episodes than those that the constants were calibrated on."""
POLICIES = ("random", "scripted", "near")
NEAR_M = 0.04
"""The ``near`` policy aims within this much of the scripted aim: attempts of every kind, hardly one without contact."""


@dataclass(frozen=True, slots=True)
class Case:
    """One action in one situation.

    Attributes
    ----------
    policy : str
    episode : int
        Index in the seed domain.
    situation : Situation
    action : int
        Grid index.
    """

    policy: str
    episode: int
    situation: Situation
    action: int


def draw_cases(
    task: str, policies: Iterable[str], count: int, simulator: Simulator, start: int = 0
) -> tuple[list[Case], int]:
    """Cases of the last step of a task: ``count`` episodes, one case for each policy and episode.

    Parameters
    ----------
    task : str
    policies : iterable of str
        Out of ``POLICIES``.
    count : int
        Episodes in which all tools could be picked up; others are passed over.
    simulator : Simulator
        Carries out the reference picks.
    start : int
        First episode of the seed domain.

    Returns
    -------
    cases : list of Case
    next : int
        The first episode that was not drawn.
    """
    wanted = tuple(policies)
    cases: list[Case] = []
    episode = start
    while len(cases) < count * len(wanted):
        rng = episode_generator(ROOT_SEED, "calibrate", task, episode)
        situation = last_situation(task, simulator, rng)
        if situation is not None:
            for policy in wanted:
                action = choose(policy, situation, rng, simulator.parameters)
                cases.append(Case(policy, episode, situation, action))
        episode += 1
    return cases, episode


def last_situation(task: str, simulator: Simulator, rng: np.random.Generator) -> Situation | None:
    """The last step of a random episode, with tools in hand; None where they could not be picked up."""
    episode = Scenario(task, "calibrate", 0, draw_episode(rng, task, simulator.parameters))
    situation = episode.first_situation()
    while not situation.last:
        outcome = reference_step(simulator, situation, rng)
        if outcome is None:
            return None
        situation = episode.next_situation(situation, outcome)
    return situation


def choose(policy: str, situation: Situation, rng: np.random.Generator, parameters: WorldParameters) -> int:
    """Grid index of a policy's action: uniform over the valid ones, at the true position, or around it."""
    valid = _valid(situation.kind, parameters)
    if policy == "random":
        allowed = np.flatnonzero(valid)
        return int(allowed[rng.integers(len(allowed))])
    x_m, y_m = kind_of(situation).aim(situation.target, parameters)
    if policy == "near":
        x_m, y_m = x_m + float(rng.uniform(-NEAR_M, NEAR_M)), y_m + float(rng.uniform(-NEAR_M, NEAR_M))
    yaw = float(rng.integers(situation.kind.angles)) * 2 * np.pi / grid.ANGLES
    i, j, k = (int(part) for part in grid.decode(grid.snap(x_m, y_m, yaw)))
    return int(grid.encode(*nearest_valid(valid, i, j, k)))


@lru_cache(maxsize=16)
def _valid(kind: StepKind, parameters: WorldParameters) -> np.ndarray:
    return np.asarray(reachable(kind, parameters).any(axis=0))
