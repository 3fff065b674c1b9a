"""Which actions the arms can carry out: computed once from kinematics, the same for every policy.

One arm acts in single-arm steps: the left one wherever it can, else the right one (the second stick of a pair is the
right arm's). Both arms reach or none does in two-arm steps, whose angles are 0..7.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.sim.kinds import KINDS
from evaluator.sim.kinematics import base_of, solve_path, within_limits
from evaluator.sim.parameters import WORLD, WorldParameters
from rema_data import grid
from rema_data.schema import TASKS, StepKind, tool_steps

Array = npt.NDArray[Any]

_SHAPE = (grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES)


@lru_cache(maxsize=16)
def reachable(kind: StepKind, parameters: WorldParameters = WORLD) -> Array:
    """Whether an arm can carry out an action, bool (2, 64, 64, 16): left, right. Read-only.

    Checked at the ends of every motion of the primitive (and in the middle of a push).
    """
    actions = np.arange(grid.ACTIONS).reshape(_SHAPE)
    x, y, theta = grid.to_world(actions)
    asked = KINDS[kind]
    shifts = asked.reach_shifts(parameters)
    result: Array = np.zeros((2, *_SHAPE), bool)
    for side, (arm, along) in enumerate((("left", 1.0), ("right", -1.0))):
        yaw = theta + asked.turns[side]
        result[side] = np.logical_and.reduce(
            [
                _path_ok(
                    base_of(arm, parameters),
                    x + along * distance * np.cos(theta),
                    y + along * distance * np.sin(theta),
                    z,
                    yaw,
                    shifts,
                    asked.symmetric,
                    parameters,
                )
                for distance in asked.reach_distances(parameters)
                for z in asked.reach_heights(parameters)
            ]
        )
    if asked.two_arms:
        result[:] = result.all(axis=0)
    result &= grid.decode(actions)[2] < kind.angles
    result &= grid.inside_valid_square()[None, :, :, None]
    result.setflags(write=False)
    return result


def _path_ok(
    base: Any, x: Array, y: Array, z: float, yaw: Array, shifts: tuple[float, ...], symmetric: bool, p: WorldParameters
) -> Array:
    xs = np.stack([x + shift for shift in shifts], axis=-1)
    ys, yaws = (np.broadcast_to(value[..., None], xs.shape) for value in (y, yaw))
    joints = solve_path(base, xs, ys, np.full(xs.shape, z), yaws, symmetric, p)
    return np.asarray(within_limits(joints, p).all(axis=-1))


@lru_cache(maxsize=16)
def valid_actions(task: str, step: int) -> Array:
    """Actions that a policy may choose at a step of a task, bool (64, 64, 16), read-only."""
    valid: Array = np.asarray(reachable(TASKS[task][step]).any(axis=0))
    valid.setflags(write=False)
    return valid


def acting_arm(task: str, step: int, action: int, parameters: WorldParameters = WORLD) -> str | None:
    """``left``, ``right`` or ``both`` for an action at a step of a task, or None where it is out of reach.

    The second stick of a two-arm task is the right arm's to pick; everything else the left arm does where it can.
    """
    kind = TASKS[task][step]
    i, j, k = grid.decode(action)
    left, right = reachable(kind, parameters)[:, i, j, k]
    if kind.embodiment.two_arms:
        return "both" if left and right else None
    second_tool = step in tool_steps(task)[1:]
    order = (("right", right), ("left", left)) if second_tool else (("left", left), ("right", right))
    return next((arm for arm, ok in order if ok), None)
