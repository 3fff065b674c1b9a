"""Where hands, held tools and the target are before an action, with the pair or hand at any pose: nothing moves here.

Cameras and pictures need the end effector as real bodies; this module says where they are, for the five kinds of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from evaluator.sim.footprints import HAND_TURNS, SIDES, inner_extents, lowest_point, pair_heights, pinched_heights
from evaluator.sim.parameters import WORLD, WorldParameters
from rema_data.schema import Embodiment, ObjectSpec, Primitive, Situation

__all__ = ["HandPose", "Thing", "hand_poses", "held_things", "start_height", "target_thing"]

ARMS = ("left", "right")


class HandPose(NamedTuple):
    """A hand that points straight down: its arm, the pose of its tool centre point (m, rad), and its opening (m)."""

    arm: str
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    opening_m: float


class Thing(NamedTuple):
    """An object that lies level: what it is to this step, what it is made of, and where its centre of mass is.

    ``role`` is ``target``, ``tool`` (held by a hand) or ``held`` (pinched between two sticks).
    """

    role: str
    spec: ObjectSpec
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


def hand_poses(
    situation: Situation,
    pose: tuple[float, float, float],
    height_m: float,
    arm: str = "left",
    closed: bool = False,
    p: WorldParameters = WORLD,
) -> list[HandPose]:
    """Poses of the hands that act at a step.

    Parameters
    ----------
    situation : Situation
    pose : (x, y, yaw)
        Of the tool centre point, or of the pair's origin; m, rad.
    height_m : float
        Height of one tool centre point; for a pair, of the zero from which its hands are raised.
    arm : str
        Which arm acts where only one does.
    closed : bool
        The end state (jaws or sticks closed) instead of the start state.
    """
    x, y, yaw = pose
    kind, grips = situation.kind, situation.grips
    if not kind.embodiment.two_arms:
        opening = 0.0 if closed or kind.primitive is Primitive.PUSH else p.opening_max_m
        return [HandPose(arm, x, y, height_m, yaw, grips[0].opening_m if grips else opening)]
    if kind.embodiment is Embodiment.STICKS:
        gap = 0.0 if closed else p.pair_open_m
        left, right = inner_extents(grips)
        distances, heights = (left + gap, right + gap), pair_heights(grips, p.pair_clearance_m)
    else:
        assert situation.pinch is not None
        distances = situation.pinch.left_m, situation.pinch.right_m
        heights = pinched_heights(grips, situation.pinch, p)
    c, s = math.cos(yaw), math.sin(yaw)
    return [
        HandPose(name, x + side * distance * c, y + side * distance * s, height_m + height, yaw + turn, grip.opening_m)
        for name, side, turn, distance, height, grip in zip(
            ARMS, SIDES, HAND_TURNS, distances, heights, grips, strict=True
        )
    ]


def held_things(situation: Situation, hands: list[HandPose], pose: tuple[float, float, float]) -> list[Thing]:
    """Tools in hands that stand at ``hands``, in their order, then the pinched object if there is one."""
    things = []
    for hand, grip in zip(hands, situation.grips, strict=False):
        x, y = _turned(grip.x_m, grip.y_m, hand.yaw_rad)
        yaw = hand.yaw_rad + grip.yaw_rad
        things.append(Thing("tool", grip.spec, hand.x_m + x, hand.y_m + y, hand.z_m + grip.z_m, yaw))
    if situation.kind.embodiment is Embodiment.PINCHED:
        pinch = situation.pinch
        assert pinch is not None
        x, y = _turned(pinch.x_m, pinch.y_m, pose[2])
        z = min(hand.z_m for hand in hands) + pinch.z_m
        things.append(Thing("held", pinch.spec, pose[0] + x, pose[1] + y, z, pose[2] + pinch.yaw_rad))
    return things


def target_thing(situation: Situation) -> Thing:
    """The object of the step, on the table."""
    target = situation.target
    return Thing("target", target.spec, target.x_m, target.y_m, target.spec.height_m / 2, target.yaw_rad)


def start_height(situation: Situation, clearance_m: float) -> float:
    """Height that keeps everything held ``clearance_m`` above the target's top."""
    lowest = min((lowest_point(grip) for grip in situation.grips), default=0.0)
    top = situation.target.spec.height_m + clearance_m
    return top if situation.kind.embodiment.two_arms else top - lowest


def _turned(x: float, y: float, yaw: float) -> tuple[float, float]:
    c, s = math.cos(yaw), math.sin(yaw)
    return c * x - s * y, s * x + c * y
