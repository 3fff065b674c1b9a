"""Grasp with two sticks: both arms close on the target with the tips of their sticks, then lift it."""

from __future__ import annotations

import math

import numpy as np

from evaluator.sim.attempt import Attempt, Ended, relative
from evaluator.sim.footprints import clear_of_target, hand_footprints, inner_extents, pair_heights
from evaluator.sim.kinds.grasp import CLEAR_M
from evaluator.sim.kinds.pair import Squeeze, command, lower, pair_path
from evaluator.sim.kinds.push import CLEAR_TOOL_M
from evaluator.sim.motion import profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import footprint
from rema_data.schema import Failure, Pinch, Situation


def can_touch(situation: Situation, pose: tuple[float, float, float], parameters: WorldParameters) -> bool:
    """Whether the sticks or hands could touch the target anywhere while they close."""
    left, right = inner_extents(situation.grips)
    opened = (parameters.pair_open_m + left, parameters.pair_open_m + right)
    way = parameters.pair_open_m - parameters.pair_empty_m
    covered = []
    for side, rects in zip((-1.0, 1.0), hand_footprints(situation.grips, opened, parameters), strict=True):
        for rect in rects:
            (x_low, x_high), (y_low, y_high) = rect.extent(0.0), rect.extent(math.pi / 2)
            x_low, x_high = x_low + min(0.0, side * way), x_high + max(0.0, side * way)
            middle = Rect((x_low + x_high) / 2, (y_low + y_high) / 2, 0.0, (x_high - x_low) / 2, (y_high - y_low) / 2)
            covered.append(middle.moved(*pose))
    return gap(covered, footprint(situation.target)) <= CLEAR_TOOL_M


def pincer(attempt: Attempt, pose: tuple[float, float, float]) -> Pinch | None:
    """Grasp the target between two sticks at (x, y, theta) and lift it; raises Ended where it fails.

    Returns
    -------
    Pinch or None
        The object as a tool between the sticks, if this step is not the task's last.
    """
    p, world = attempt.parameters, attempt.world
    grips = attempt.situation.grips
    x, y, theta = pose
    extents = inner_extents(grips)
    opened = (p.pair_open_m + extents[0], p.pair_open_m + extents[1])
    heights = pair_heights(grips, p.pair_clearance_m)
    tick = p.time_step_s * p.control_every

    # Closing: each row brings the tips one tick nearer
    travel = np.arange(0.0, p.pair_open_m - p.pair_empty_m, p.pair_closing_speed_m_s * tick)
    here = np.tile([x, y, 0.0], (len(travel), 1))
    closing = pair_path(attempt, here, theta, (opened[0] - travel, opened[1] - travel), heights)
    lift = profile(p.pair_lift_height_m, p.pair_lift_speed_m_s, tick, p.ramp_share)
    rise = np.stack([np.full_like(lift, x), np.full_like(lift, y), p.pair_lift_height_m * lift], axis=1)

    footprints = [rect for hand in hand_footprints(grips, opened, p) for rect in hand]
    start = 0.0
    if not clear_of_target(attempt.situation, footprints, pose, CLEAR_M):
        start = attempt.situation.target.spec.height_m + p.approach_clearance_m - p.pair_clearance_m
    down = lower(attempt, pose, start, closing, opened, heights)
    attempt.allowed = tuple(hand.tool for hand in attempt.hands if hand.tool is not None)
    attempt.step(p.grip_settle_steps)
    if down is not None:
        attempt.descend(down.of_each_hand())

    squeeze = Squeeze(attempt.target)
    contact = None
    for row in range(1, len(travel)):
        command(attempt, closing, row, 0.0)
        attempt.step(p.control_every)
        left, right = squeeze.forces(attempt)
        attempt.evidence.contact_steps += left > 0 or right > 0
        if min(left, right) >= p.pair_contact_n:
            contact = row
            break
    if contact is None:
        raise Ended(Failure.NOT_LIFTED if attempt.evidence.contact_steps else Failure.MISSED)

    distances = (opened[0] - travel[contact], opened[1] - travel[contact])
    up = pair_path(attempt, rise, theta, distances, heights)
    squeeze.hold(attempt, up, 0, p.pair_squeeze_steps)
    rest_z = attempt.situation.target.spec.height_m / 2

    def watch() -> None:
        attempt.evidence.lift_m = max(attempt.evidence.lift_m, world.pose(attempt.target)[2] - rest_z)

    try:
        squeeze.carry(attempt, up, Failure.NOT_LIFTED, watch)
        squeeze.hold(attempt, up, len(lift) - 1, p.hold_steps)
    except Ended as ended:
        if ended.failure is Failure.NOT_LIFTED and attempt.evidence.lift_m > p.slip_lift_m:
            raise Ended(Failure.SLIPPED) from None
        raise
    height = world.pose(attempt.target)[2] - rest_z
    if not attempt.tools_held():
        raise Ended(Failure.TOOL_LOST)
    if height < p.pair_success_lift_m or min(squeeze.forces(attempt)) <= 0:
        raise Ended(Failure.SLIPPED if attempt.evidence.lift_m > p.slip_lift_m else Failure.NOT_LIFTED)
    if attempt.situation.last:
        return None
    if world.tilt(attempt.target) > p.max_tool_tilt_rad:
        raise Ended(Failure.TOOL_LOST)
    left_m, right_m, frame = pair_frame(attempt, theta)
    px, py, pz, pyaw = relative(world.pose(attempt.target), frame)
    return Pinch(attempt.situation.target.spec, px, py, pz, pyaw, left_m, right_m)


def pair_frame(attempt: Attempt, theta: float) -> tuple[float, float, tuple[float, float, float, float]]:
    """Distances of the hands from the pair's origin, and the pair frame (x, y, z of the lower hand, yaw)."""
    left, right = (hand.arm.hand_pose() for hand in attempt.hands)
    extents = inner_extents(attempt.situation.grips)
    c, s = math.cos(theta), math.sin(theta)
    along = (left[0] - right[0]) * c + (left[1] - right[1]) * s
    half = (along - extents[0] - extents[1]) / 2  # from the origin to each tip
    left_m, right_m = half + extents[0], half + extents[1]
    x, y = left[0] - left_m * c, left[1] - left_m * s
    return left_m, right_m, (x, y, min(left[2], right[2]), theta)
