"""Closed-form inverse kinematics of an iiwa whose hand points straight down.

With joints 3 and 5 at zero the arm is planar: shoulder and elbow form a triangle that reaches the wrist, joint 6 turns
the hand down and joint 7 sets its yaw. Vectorised, no iteration, no seed: the same pose always gives the same joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.sim.parameters import WORLD, WorldParameters

SHOULDER_M, UPPER_M, LOWER_M, WRIST_M = 0.36, 0.42, 0.40, 0.081
"""Base to shoulder, shoulder to elbow, elbow to wrist, wrist to the frame of link 7 (LBR iiwa 7 R800)."""

LIMITS_RAD = np.array([2.96706, 2.09440, 2.96706, 2.09440, 2.96706, 2.09440, 3.05433])
"""Joint limits of the real arm, symmetric, radians."""

MOUNT_RAD = np.pi / 2
"""How the hand is screwed onto the flange: its closing axis is the -y axis of link 7, a quarter turn ahead of x. So the
half circle of a pair's angles falls into the middle of joint 7's range on both arms."""

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Base:
    """Where an arm stands: position (m) and yaw (rad) in the world frame."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


def base_of(arm: str, parameters: WorldParameters = WORLD) -> Base:
    """Base of the ``left`` (at +y, facing -y) or ``right`` (at -y, facing +y) arm."""
    side = {"left": 1.0, "right": -1.0}[arm]
    return Base(0.0, side * parameters.base_y_m, parameters.base_z_m, -side * np.pi / 2)


def joint_limits(parameters: WorldParameters = WORLD) -> Array:
    """Limits used here, float64 (7,): the real ones but for joint 4."""
    limits = LIMITS_RAD.copy()
    limits[3] = parameters.joint4_limit_rad
    return limits - parameters.joint_margin_rad


def solve(base: Base, x_m: Any, y_m: Any, z_m: Any, yaw_rad: Any, parameters: WorldParameters = WORLD) -> Array:
    """Joints that put the tool centre point at a world pose, the hand pointing down; yaw is that of the closing axis.

    Takes floats or arrays (...); gives radians, float64 (..., 7), NaN where the pose is farther than the arm is long.
    Joint 7 is wrapped to [-pi, pi): unwrap it along a path. Joint limits are not checked here.
    """
    c, s = np.cos(base.yaw_rad), np.sin(base.yaw_rad)
    dx, dy = np.asarray(x_m, float) - base.x_m, np.asarray(y_m, float) - base.y_m
    bx, by = c * dx + s * dy, c * dy - s * dx
    radius = np.hypot(bx, by)
    height = np.asarray(z_m, float) + parameters.tcp_offset_m + WRIST_M - base.z_m - SHOULDER_M
    cos_elbow = (radius**2 + height**2 - UPPER_M**2 - LOWER_M**2) / (2 * UPPER_M * LOWER_M)
    elbow = np.arccos(np.where(np.abs(cos_elbow) <= 1, cos_elbow, np.nan))
    q1 = np.arctan2(by, bx)
    q2 = np.arctan2(radius, height) - np.arctan2(LOWER_M * np.sin(elbow), UPPER_M + LOWER_M * np.cos(elbow))
    q7 = np.mod(q1 + base.yaw_rad - np.asarray(yaw_rad, float) + MOUNT_RAD + 2 * np.pi, 2 * np.pi) - np.pi
    joints = np.zeros((*np.broadcast(q1, q2, q7).shape, 7))
    joints[..., 0] = q1
    joints[..., 1] = q2
    joints[..., 3] = -elbow
    joints[..., 5] = np.pi - q2 - elbow
    joints[..., 6] = q7
    return joints


def solve_path(
    base: Base, x_m: Any, y_m: Any, z_m: Any, yaw_rad: Any, symmetric: bool, parameters: WorldParameters = WORLD
) -> Array:
    """Joints along a path (the last axis), float64 (..., n, 7): joint 7 continuous, as far from its limits as possible.

    ``symmetric``: the hand looks the same after half a turn (bare gripper), so that joint 7 may be turned by pi.
    """
    joints = solve(base, x_m, y_m, z_m, yaw_rad, parameters)
    q7 = joints[..., 6]
    if not (np.abs(np.diff(q7)) < np.pi).all():  # NaN is not; else unwrapping would change nothing
        q7 = np.unwrap(q7, axis=-1)
    turn = np.pi if symmetric else 2 * np.pi
    middle = (q7.max(axis=-1, keepdims=True) + q7.min(axis=-1, keepdims=True)) / 2
    joints[..., 6] = q7 - turn * np.rint(middle / turn)
    return joints


def within_limits(joints: Array, parameters: WorldParameters = WORLD) -> Array:
    """Whether every joint of (..., 7) is within its limits (NaN is not), bool (...)."""
    return np.asarray((np.abs(joints) <= joint_limits(parameters)).all(axis=-1))
