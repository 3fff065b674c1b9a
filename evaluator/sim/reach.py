"""Which actions the arms can carry out: computed once from kinematics, the same for every policy.

One arm acts in single-arm steps: the left one wherever it can, else the right one (the second stick of a pair is the
right arm's). Both arms reach or none does in two-arm steps, whose angles are 0..7.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.sim.kinematics import base_of, solve_path, within_limits
from evaluator.sim.parameters import WORLD, WorldParameters
from rema_data import grid
from rema_data.schema import TASKS, Embodiment, Primitive, StepKind

Array = npt.NDArray[Any]

_SHAPE = (grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES)
TOOL_HEIGHTS_M = (0.0, 0.03)
"""Heights of the tool centre point between which a held tool's lowest point is at its clearance."""


def hand_yaws(kind: StepKind, theta: Any) -> tuple[Any, Any]:
    """Yaw of the left and of the right hand for an action angle (rad).

    A single hand's closing axis turns with the action. In a pair the sticks lie along the pair's axis, across the
    jaws, and the right hand is the left one turned by half a turn about the pair's origin.
    """
    if kind.embodiment.two_arms:
        return theta + np.pi / 2, theta + 3 * np.pi / 2
    return theta, theta


def pair_distances(parameters: WorldParameters) -> tuple[float, float]:
    """Smallest and largest distance of a hand from the pair's origin: sticks held within a quarter of their middle."""
    half_short, half_long = parameters.stick_length_min_m / 2, parameters.stick_length_max_m / 2
    return 0.75 * half_short, 1.25 * half_long + parameters.pair_open_m


def _motion(kind: StepKind, p: WorldParameters) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Where a hand must be able to go: distances from the action's place, heights, and shifts along +x (m)."""
    distances = pair_distances(p) if kind.embodiment.two_arms else (0.0,)
    shifts = (0.0,) if kind.primitive is Primitive.GRASP else (0.0, p.push_distance_m / 2, p.push_distance_m)
    if kind.embodiment is not Embodiment.GRIPPER:
        lift = (TOOL_HEIGHTS_M[1] + p.pair_lift_height_m,) if kind.primitive is Primitive.GRASP else ()
        return distances, (*TOOL_HEIGHTS_M, *lift), shifts
    if kind.primitive is Primitive.GRASP:
        return distances, (p.grasp_height_m, p.grasp_height_m + p.lift_height_m), shifts
    return distances, (p.push_height_m,), shifts


@lru_cache(maxsize=16)
def reachable(kind: StepKind, parameters: WorldParameters = WORLD) -> Array:
    """Whether an arm can carry out an action, bool (2, 64, 64, 16): left, right. Read-only.

    Checked at the ends of every motion of the primitive (and in the middle of a push).
    """
    actions = np.arange(grid.ACTIONS).reshape(_SHAPE)
    x, y, theta = grid.to_world(actions)
    distances, heights, shifts = _motion(kind, parameters)
    symmetric = kind.embodiment is Embodiment.GRIPPER
    result: Array = np.zeros((2, *_SHAPE), bool)
    for side, (arm, along) in enumerate((("left", 1.0), ("right", -1.0))):
        yaw = hand_yaws(kind, theta)[side]
        result[side] = np.logical_and.reduce(
            [
                _path_ok(
                    base_of(arm, parameters),
                    x + along * distance * np.cos(theta),
                    y + along * distance * np.sin(theta),
                    z,
                    yaw,
                    shifts,
                    symmetric,
                    parameters,
                )
                for distance in distances
                for z in heights
            ]
        )
    if kind.embodiment.two_arms:
        result[:] = result.all(axis=0) & (grid.decode(actions)[2] < grid.PAIR_ANGLES)
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
    second_stick = step == 1 and kind.primitive is Primitive.GRASP
    order = (("right", right), ("left", left)) if second_stick else (("left", left), ("right", right))
    return next((arm for arm, ok in order if ok), None)
