"""Records of what stands where before anything moves: hands, objects, and the boxes that a map shows."""

from __future__ import annotations

import math
from typing import NamedTuple

from evaluator.sim.planar import Rect
from rema_data.schema import ObjectSpec, Situation

__all__ = ["ARMS", "HandPose", "Part", "Pose", "Thing", "target_thing", "turned"]

ARMS = ("left", "right")
Pose = tuple[float, float, float]
"""Where an action is carried out: x, y (m) and yaw (rad) of the hand, or of the pair where two arms act as one."""


class HandPose(NamedTuple):
    """A hand that points straight down: its arm, the pose of its tool centre point (m, rad), and its opening (m)."""

    arm: str
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    opening_m: float


class Thing(NamedTuple):
    """An object that lies level: what it is to this step, what it is made of, and where its centre of mass is."""

    role: str  # ``target``, ``tool`` (held by a hand), ``held`` (pinched between two sticks) or ``other`` (beside it)
    spec: ObjectSpec
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


class Part(NamedTuple):
    """A box of the end effector in the map's frame: footprint, bottom and top (m, one common zero), may it touch."""

    rect: Rect
    bottom_m: float
    top_m: float
    allowed: bool


def target_thing(situation: Situation) -> Thing:
    """The object of the step, on the table."""
    target = situation.target
    return Thing("target", target.spec, target.x_m, target.y_m, target.spec.height_m / 2, target.yaw_rad)


def turned(frame: Pose, x_m: float, y_m: float) -> tuple[float, float]:
    """World place of a point of a frame whose origin and yaw are ``frame``."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    return frame[0] + c * x_m - s * y_m, frame[1] + s * x_m + c * y_m
