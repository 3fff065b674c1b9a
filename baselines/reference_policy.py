"""The privileged picker: one well-placed grasp, or pinch, of an object whose place and shape it knows. Privileged.

Collections let it pick tools, so that the step under study starts with a tool in hand and not with a missed pick.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from baselines.observation_hash import observation_numbers
from baselines.scripted_policy import ScriptedPolicy
from evaluator.policy.contract import ObservationBatch
from evaluator.sim.kinds import kind_of
from evaluator.sim.parameters import WORLD
from evaluator.sim.planar import gap
from evaluator.sim.shapes import boxes, footprint
from rema_data import grid
from rema_data.schema import TASKS, Placement, Situation

__all__ = ["ReferencePolicy"]

_AIMS = 41
"""Places along a bar that a pinch may aim at."""
_CLEARANCE_M = 0.002
"""Room that the descending sticks must have beside the object."""
_M_PER_RAD = 0.02
"""A pinch that is turned against its bar by an angle is as bad as one this much further from the centre of mass."""

Valid = npt.NDArray[np.bool_]


class ReferencePolicy:
    """Grasps across a bar near its middle, with room for the fingers; pinches across a bar near the centre of mass.

    A grasp is the first choice of ``evaluator.sim.reference``, which may try several: where along the bar, and which
    way round, is a pure function of the observation. What has no such choice (a push, an object that nothing fits
    around) is left to the scripted policy.

    Parameters
    ----------
    checkpoint : Path or None
        Not used.
    device : str
        Not used.
    """

    privileged: ClassVar[bool] = True

    def __init__(self, checkpoint: Path | None = None, device: str = "cpu") -> None:
        self._otherwise = ScriptedPolicy()

    def act(self, observations: ObservationBatch, situations: tuple[Situation, ...]) -> npt.NDArray[np.int64]:
        """Grid indices, int64 (N,)."""
        actions = self._otherwise.act(observations, situations)
        makes = TASKS[observations.task][observations.step].makes
        if makes is None:
            return actions
        for n, number in enumerate(observation_numbers(observations)):
            valid, situation = observations.valid[n].reshape(-1), situations[n]
            best = _pinch(situation, valid) if makes == "pinch" else _first(situation, valid, number)
            if best is not None:
                actions[n] = best
        return actions


def _first(situation: Situation, valid: Valid, number: int) -> int | None:
    """The first candidate of the reference that made the frozen scenarios; a push has none."""
    random = np.random.default_rng(number)
    return next(kind_of(situation).candidates(situation.target, valid, random, WORLD), None)


def _pinch(situation: Situation, valid: Valid) -> int | None:
    """Across a bar where the open sticks have room, with the centre of mass as near to their line as can be."""
    sticks, obstacles = kind_of(situation).footprint(situation, WORLD), footprint(situation.target)
    for _, action in sorted(_pinch_aims(situation.target)):
        x_m, y_m, theta = (float(value) for value in grid.to_world(action))
        if valid[action] and gap((rect.moved(x_m, y_m, theta) for rect in sticks), obstacles) > _CLEARANCE_M:
            return action
    return None


def _pinch_aims(target: Placement) -> set[tuple[float, int]]:
    """Grid actions that close across a bar, each with the lever of its weight (m) and what its turn is worth."""
    aims = set()
    turn = 2 * math.pi / grid.ANGLES
    for bar in boxes(target.spec):
        placed = bar.moved(target.x_m, target.y_m, target.yaw_rad)
        along = bar.half_x >= bar.half_y
        half, axis = (bar.half_x, placed.yaw) if along else (bar.half_y, placed.yaw + math.pi / 2)
        across = (axis + math.pi / 2) % math.pi
        k = round(across / turn) % grid.PAIR_ANGLES
        for offset in np.linspace(-half, half, _AIMS).tolist():
            x_m, y_m = placed.x + offset * math.cos(axis), placed.y + offset * math.sin(axis)
            action = int(grid.snap(x_m, y_m, k * turn))
            x_m, y_m, theta = (float(value) for value in grid.to_world(action))
            error = abs((across - theta + math.pi / 2) % math.pi - math.pi / 2)
            lever = abs(math.cos(theta) * (y_m - target.y_m) - math.sin(theta) * (x_m - target.x_m))
            aims.add((lever + _M_PER_RAD * error, action))
    return aims
