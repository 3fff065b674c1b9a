"""The two-stick pincer: both arms close on the target with the tips of their sticks, then lift it, or push with it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from evaluator.sim.attempt import Attempt, Ended, clear_of_target, relative, wrap
from evaluator.sim.motion import profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.primitives.grasp import CLEAR_M
from evaluator.sim.primitives.pair import (
    PairPath,
    Squeeze,
    command,
    hand_footprints,
    inner_extents,
    pair_heights,
    pair_path,
    take_sticks,
)
from evaluator.sim.primitives.push import POLL_EVERY, judge, settle, swept
from evaluator.sim.shapes import boxes, footprint
from rema_data.schema import Embodiment, Failure, Grip, Pinch, Placement, Situation

OVERLAP_M = 0.004
"""How far the tips would pass each other before a closing counts as empty."""
CONTACT_N = 5.0
"""Both sticks feel the target."""
SQUEEZE_STEPS = 40
"""Simulation steps of squeezing before the lift."""


def can_touch(situation: Situation, pose: tuple[float, float, float], parameters: WorldParameters) -> bool:
    """Whether the sticks, hands or pinched object could touch the target anywhere on their way."""
    target = footprint(situation.target)
    margin = parameters.max_tool_slip_m
    grips = situation.grips
    if situation.kind.embodiment is Embodiment.STICKS:
        left, right = inner_extents(grips)
        opened = (parameters.pair_open_m + left, parameters.pair_open_m + right)
        way = parameters.pair_open_m + OVERLAP_M
        covered = []
        for side, rects in zip((-1.0, 1.0), hand_footprints(grips, opened, parameters), strict=True):
            for rect in rects:
                (x_low, x_high), (y_low, y_high) = rect.extent(0.0), rect.extent(math.pi / 2)
                x_low, x_high = x_low + min(0.0, side * way), x_high + max(0.0, side * way)
                covered.append(Rect((x_low + x_high) / 2, (y_low + y_high) / 2, 0.0, (x_high - x_low) / 2,
                                    (y_high - y_low) / 2).moved(*pose))  # fmt: skip
        return gap(covered, target) <= margin
    assert situation.pinch is not None
    rects = pinched_footprint(grips, situation.pinch, parameters)
    return gap(swept(rects, pose, parameters.push_distance_m), target) <= margin


def pinched_footprint(grips: tuple[Grip, ...], pinch: Pinch, parameters: WorldParameters) -> tuple[Rect, ...]:
    """Footprint in the pair frame of everything that moves in a push with a pinched object."""
    hands = hand_footprints(grips, (pinch.left_m, pinch.right_m), parameters)
    held = (box.moved(pinch.x_m, pinch.y_m, pinch.yaw_rad) for box in boxes(pinch.spec))
    return (*hands[0], *hands[1], *held)


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
    travel = np.arange(0.0, p.pair_open_m + OVERLAP_M, p.pair_closing_speed_m_s * tick)
    here = np.tile([x, y, 0.0], (len(travel), 1))
    closing = pair_path(attempt, here, theta, (opened[0] - travel, opened[1] - travel), heights)
    lift = profile(p.pair_lift_height_m, p.pair_lift_speed_m_s, tick, p.ramp_share)
    rise = np.stack([np.full_like(lift, x), np.full_like(lift, y), p.pair_lift_height_m * lift], axis=1)

    footprints = [rect for hand in hand_footprints(grips, opened, p) for rect in hand]
    start = 0.0
    if not clear_of_target(attempt.situation, footprints, pose, CLEAR_M):
        start = attempt.situation.target.spec.height_m + p.approach_clearance_m - p.pair_clearance_m
    lower(attempt, pose, start, closing, opened, heights)

    squeeze = Squeeze(attempt.target)
    contact = None
    for row in range(1, len(travel)):
        command(attempt, closing, row, 0.0)
        attempt.step(p.control_every)
        left, right = squeeze.forces(attempt)
        attempt.evidence.contact_steps += left > 0 or right > 0
        if min(left, right) >= CONTACT_N:
            contact = row
            break
    if contact is None:
        raise Ended(Failure.NOT_LIFTED if attempt.evidence.contact_steps else Failure.MISSED)

    distances = (opened[0] - travel[contact], opened[1] - travel[contact])
    up = pair_path(attempt, rise, theta, distances, heights)
    squeeze.hold(attempt, up, 0, SQUEEZE_STEPS)
    rest_z = attempt.situation.target.spec.height_m / 2

    def watch() -> None:
        attempt.evidence.lift_m = max(attempt.evidence.lift_m, world.pose(attempt.target)[2] - rest_z)

    try:
        squeeze.carry(attempt, up, Failure.NOT_LIFTED, watch)
        squeeze.hold(attempt, up, len(lift) - 1, p.hold_steps)
    except Ended as ended:
        if ended.failure is Failure.NOT_LIFTED and attempt.evidence.lift_m > 0.01:
            raise Ended(Failure.SLIPPED) from None
        raise
    world.check(attempt.target)
    height = world.pose(attempt.target)[2] - rest_z
    if not attempt.tools_held():
        raise Ended(Failure.TOOL_LOST)
    if height < p.pair_success_lift_m or min(squeeze.forces(attempt)) <= 0:
        raise Ended(Failure.SLIPPED if attempt.evidence.lift_m > 0.01 else Failure.NOT_LIFTED)
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


def lower(
    attempt: Attempt,
    pose: tuple[float, float, float],
    start_m: float,
    at_bottom: PairPath,
    distances: tuple[float, float],
    heights: tuple[float, float],
) -> None:
    """Bring the opened pair to the first row of ``at_bottom``, from ``start_m`` above it if there is something below."""
    p = attempt.parameters
    x, y, theta = pose
    if start_m <= 0.0:
        for side, hand in enumerate(attempt.hands):
            assert hand.grip is not None
            hand.arm.reset(at_bottom.positions[side, 0], hand.grip.opening_m)
        take_sticks(attempt, pose, distances, heights)
        _sticks_may_touch(attempt)
        attempt.world.step(p.grip_settle_steps)
        return
    down = descent(attempt, pose, start_m, distances, heights)
    for side, hand in enumerate(attempt.hands):
        assert hand.grip is not None
        down.positions[side, :, 6] += at_bottom.positions[side, 0, 6] - down.positions[side, -1, 6]
        hand.arm.reset(down.positions[side, 0], hand.grip.opening_m)
    raised = (heights[0] + start_m, heights[1] + start_m)
    take_sticks(attempt, pose, distances, raised)
    _sticks_may_touch(attempt)
    attempt.world.step(p.grip_settle_steps)
    from evaluator.sim.motion import JointPath

    attempt.descend([JointPath(down.positions[side], down.velocities[side]) for side in range(2)])


def descent(
    attempt: Attempt,
    pose: tuple[float, float, float],
    start_m: float,
    distances: tuple[Any, Any],
    heights: tuple[float, float],
) -> PairPath:
    """Path of the pair straight down by ``start_m``."""
    p = attempt.parameters
    shares = profile(start_m, p.descend_speed_m_s, p.time_step_s * p.control_every, p.ramp_share)
    fall = np.stack(
        [np.full_like(shares, pose[0]), np.full_like(shares, pose[1]), start_m * (1 - shares)], axis=1
    )
    return pair_path(attempt, fall, pose[2], distances, heights)


def _sticks_may_touch(attempt: Attempt) -> None:
    if attempt.situation.kind.embodiment is Embodiment.STICKS:
        attempt.allowed = tuple(hand.tool for hand in attempt.hands if hand.tool is not None)


def push_pinched(attempt: Attempt, pose: tuple[float, float, float]) -> None:
    """Push the target 30 cm in +x with an object pinched between two sticks; raises Ended where it fails."""
    p, world = attempt.parameters, attempt.world
    pinch, grips = attempt.situation.pinch, attempt.situation.grips
    assert pinch is not None
    x, y, theta = pose
    distances = (pinch.left_m, pinch.right_m)
    # the hands keep the heights they pinched at; the whole is lowered until its lowest point is at the clearance
    heights = pair_heights(grips, p.pair_clearance_m)
    bottom = min(min(heights) + pinch.z_m - pinch.spec.height_m / 2, p.pair_clearance_m)
    heights = (heights[0] + p.pinched_clearance_m - bottom, heights[1] + p.pinched_clearance_m - bottom)
    tick = p.time_step_s * p.control_every
    shares = profile(p.push_distance_m, p.pinched_push_speed_m_s, tick, p.ramp_share)
    way = np.stack([x + p.push_distance_m * shares, np.full_like(shares, y), np.zeros_like(shares)], axis=1)
    across = pair_path(attempt, way, theta, distances, heights)

    start = 0.0
    if not clear_of_target(attempt.situation, pinched_footprint(grips, pinch, p), pose, CLEAR_M):
        start = attempt.situation.target.spec.height_m + p.approach_clearance_m - p.pinched_clearance_m
    raised = (heights[0] + start, heights[1] + start)
    path = descent(attempt, pose, start, distances, heights) if start > 0 else across
    for side, hand in enumerate(attempt.hands):
        assert hand.grip is not None
        path.positions[side, :, 6] += across.positions[side, 0, 6] - path.positions[side, -1 if start > 0 else 0, 6]
        hand.arm.reset(path.positions[side, 0], hand.grip.opening_m)
    take_sticks(attempt, pose, distances, raised)
    c, s = math.cos(theta), math.sin(theta)
    held = world.place(
        pinch.spec,
        x + c * pinch.x_m - s * pinch.y_m,
        y + s * pinch.x_m + c * pinch.y_m,
        min(raised) + pinch.z_m,
        theta + pinch.yaw_rad,
    )
    sticks = tuple(hand.tool for hand in attempt.hands if hand.tool is not None)
    attempt.allowed, attempt.forbidden = (held,), (*attempt.forbidden, *sticks)
    squeeze = Squeeze(held, p.pair_max_correction_m)
    if squeeze.hold(attempt, path, 0, SQUEEZE_STEPS) <= 0:
        raise Ended(Failure.TOOL_LOST)
    if start > 0:
        _descend_squeezing(attempt, path, squeeze)
    start_x = world.pose(attempt.target)[0]
    counter = [0]

    def watch() -> None:
        counter[0] += 1
        if counter[0] % (POLL_EVERY // p.control_every) == 0:
            attempt.touched()

    squeeze.carry(attempt, across, Failure.TOOL_LOST, watch)
    squeeze.hold(attempt, across, len(shares) - 1, POLL_EVERY * 4)
    settle(attempt)
    _, _, frame = pair_frame(attempt, theta)
    px, py, pz, pyaw = relative(world.pose(held), frame)
    slip = math.dist((px, py, pz), (pinch.x_m, pinch.y_m, pinch.z_m))
    turned = abs(wrap(pyaw - pinch.yaw_rad))
    if min(squeeze.forces(attempt)) <= 0 or slip > p.max_tool_slip_m or turned > p.max_tool_turn_rad:
        raise Ended(Failure.TOOL_LOST)
    judge(attempt, start_x)


def _descend_squeezing(attempt: Attempt, path: PairPath, squeeze: Squeeze) -> None:
    p, world, target = attempt.parameters, attempt.world, attempt.target

    def watch() -> None:
        bodies = (*attempt.allowed, *attempt.forbidden)
        force = sum(world.force(body, target) for body in bodies)
        attempt.evidence.peak_force_n = max(attempt.evidence.peak_force_n, force)
        if force > p.stop_force_n:
            raise Ended(Failure.BLOCKED)

    squeeze.carry(attempt, path, Failure.TOOL_LOST, watch)


def pinch_target(situation: Situation) -> Placement:
    """The object between the sticks."""
    return situation.target
