"""Grasp with the gripper: down at p, close, up to 30 cm above p."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from evaluator.sim.attempt import CLEAR_M, POLL_EVERY, Attempt, AttemptFailed, relative
from evaluator.sim.footprints import finger_footprint
from evaluator.sim.kinds.base import Flags
from evaluator.sim.kinds.primitives import GraspKind
from evaluator.sim.motion import line, profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import boxes, footprint
from evaluator.sim.staging import Pose
from rema_data import grid
from rema_data.schema import Embodiment, Failure, Grip, Placement, Primitive, Situation, StepKind

__all__ = ["Grasp"]

NEAR_MIDDLE = 0.10
"""A reference pick aims within this share of a bar's length from the bar's middle, where the shape leaves room."""
CLEARANCE_M = 0.0015
"""Room that the descending fingers of a reference pick must have beside the object."""


class Grasp(GraspKind):
    """A grasp with bare fingers. Where it is not the last step of a task, the object becomes a tool."""

    step = StepKind(Primitive.GRASP, Embodiment.GRIPPER)
    acting, touching = "the gripper", "the fingers"
    symmetric = True

    def openings(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        return (0.0 if closed else p.opening_max_m,)

    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        return p.grasp_height_m, p.grasp_height_m + p.lift_height_m

    def success_lift_m(self, p: WorldParameters) -> float:
        return p.grasp_success_lift_m

    def can_touch(self, situation: Situation, pose: Pose, p: WorldParameters) -> bool:
        """Descending open and closing sweep one rectangle."""
        half_x = p.opening_max_m / 2 + p.finger_thickness_m
        swept = Rect(0, 0, 0, half_x, p.finger_lateral_m / 2)
        return gap([swept.moved(*pose)], footprint(situation.target)) <= CLEAR_M

    def carry_out(self, attempt: Attempt, pose: Pose) -> Grip | None:
        """Grasp at (x, y, yaw)."""
        p, world, (hand,) = attempt.parameters, attempt.world, attempt.hands
        situation, tick = attempt.situation, attempt.tick_s
        x, y, yaw = pose
        low = p.grasp_height_m
        lift = profile(p.lift_height_m, p.lift_speed_m_s, tick, p.ramp_share)
        up = line(hand.arm.base, (x, y, low), (x, y, low + p.lift_height_m), yaw, lift, tick, self.symmetric, p)
        if not up.reachable:
            raise AttemptFailed(Failure.UNREACHABLE)
        self.approach(attempt, pose, low, up)
        _close(attempt)
        if hand.arm.fingers()[0] < p.empty_opening_m:
            raise AttemptFailed(Failure.NOT_LIFTED if attempt.evidence.contact_steps else Failure.MISSED)

        rest_z = world.pose(attempt.target)[2]
        lost = 0
        for row, target in enumerate(up.targets()):
            hand.arm.follow(*target)
            attempt.step(p.control_every)
            if row % (POLL_EVERY // p.control_every) == 0:
                attempt.note_lift(rest_z)
                lost = 0 if attempt.touched() else lost + 1
                if lost * POLL_EVERY == p.lost_steps:  # out of a rising hand's reach for good
                    raise self.dropped(attempt)
        attempt.step(p.hold_steps)
        if attempt.note_lift(rest_z) < p.grasp_success_lift_m or not attempt.touched():
            raise self.dropped(attempt)
        if situation.last:
            return None
        if world.tilt(attempt.target) > p.max_tool_tilt_rad:
            raise AttemptFailed(Failure.TOOL_LOST)
        in_hand = relative(world.pose(attempt.target), hand.arm.hand_pose())
        return Grip(situation.target.spec, *in_hand, hand.arm.fingers()[0])

    def candidates(
        self, target: Placement, valid: Flags, rng: np.random.Generator, p: WorldParameters
    ) -> Iterator[int]:
        """Across a bar, near its middle first, with room for the open fingers on both sides."""
        aims: list[tuple[float, float, float, float]] = []
        for bar in boxes(target.spec):
            placed = bar.moved(target.x_m, target.y_m, target.yaw_rad)
            along = bar.half_x >= bar.half_y
            half, axis = (bar.half_x, placed.yaw) if along else (bar.half_y, placed.yaw + math.pi / 2)
            for offset in (np.linspace(-0.35, 0.35, 15) + rng.uniform(-0.02, 0.02, 15)).tolist():
                rank, off = abs(offset) + (0.0 if along else 0.3), offset * 2 * half
                aims.append((rank, placed.x + off * math.cos(axis), placed.y + off * math.sin(axis), axis))
        near = [aim for aim in aims if aim[0] <= NEAR_MIDDLE]
        rng.shuffle(near)  # type: ignore[arg-type]
        rest = sorted(aim for aim in aims if aim[0] > NEAR_MIDDLE)
        flip = math.pi * int(rng.integers(2))
        fingers = finger_footprint(p.opening_max_m, p)
        obstacles = footprint(target)
        for _, x, y, axis in (*near, *rest):
            action = int(grid.snap(x, y, (axis + math.pi / 2 + flip) % (2 * math.pi)))
            px, py, yaw = (float(value) for value in grid.to_world(action))
            if valid[action] and gap((rect.moved(px, py, yaw) for rect in fingers), obstacles) > CLEARANCE_M:
                yield action


def _close(attempt: Attempt) -> None:
    """Close the jaws until the fingers stand still."""
    p, (hand,) = attempt.parameters, attempt.hands
    hand.arm.close_fingers()
    longest = int(p.opening_max_m / 2 / p.finger_speed_m_s / p.time_step_s) + 30
    still = 0
    for _ in range(longest // POLL_EVERY):
        attempt.step(POLL_EVERY)
        attempt.touched()
        still = still + 1 if hand.arm.fingers()[1] < p.finger_still_m_s else 0
        if still == 3:
            return
