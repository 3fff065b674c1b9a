"""Push with the closed gripper or with a held tool: down at p, 30 cm in +x."""

from __future__ import annotations

import math

from evaluator.sim.attempt import Attempt, Ended
from evaluator.sim.footprints import clear_of_target, hand_footprint, lowest_point
from evaluator.sim.kinds.grasp import CLEAR_M
from evaluator.sim.motion import line, profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import footprint
from rema_data.schema import Failure, Grip, Situation

POLL_EVERY = 4
CLEAR_TOOL_M = 0.005
"""As ``CLEAR_M``, for a held tool, which may shift a little in the hand before it touches anything."""


def swept(footprints: tuple[Rect, ...], pose: tuple[float, float, float], distance_m: float) -> list[Rect]:
    """Rectangles of the world frame that cover ``footprints`` on their way from ``pose`` along +x."""
    covered = []
    for rect in footprints:
        placed = rect.moved(*pose)
        (x_low, x_high), (y_low, y_high) = placed.extent(0.0), placed.extent(math.pi / 2)
        x_high += distance_m
        covered.append(
            Rect((x_low + x_high) / 2, (y_low + y_high) / 2, 0.0, (x_high - x_low) / 2, (y_high - y_low) / 2)
        )
    return covered


def can_touch(
    situation: Situation, grip: Grip | None, pose: tuple[float, float, float], parameters: WorldParameters
) -> bool:
    """Whether hand or tool could touch the target anywhere on the way."""
    shape = hand_footprint(0.0 if grip is None else grip.opening_m, grip, parameters)
    margin = CLEAR_M if grip is None else CLEAR_TOOL_M
    return gap(swept(shape, pose, parameters.push_distance_m), footprint(situation.target)) <= margin


def push(attempt: Attempt, pose: tuple[float, float, float]) -> None:
    """Carry out a push from (x, y, yaw); raises Ended where it fails."""
    p, world, (hand,) = attempt.parameters, attempt.world, attempt.hands
    x, y, yaw = pose
    grip = hand.grip
    opening = 0.0 if grip is None else grip.opening_m
    low = p.push_height_m if grip is None else p.tool_clearance_m - lowest_point(grip)
    tick = p.time_step_s * p.control_every
    symmetric = grip is None
    speed = p.push_speed_m_s if grip is None else p.tool_push_speed_m_s
    shares = profile(p.push_distance_m, speed, tick, p.ramp_share)
    across = line(hand.arm.base, (x, y, low), (x + p.push_distance_m, y, low), yaw, shares, tick, symmetric, p)
    if not across.reachable:
        raise Ended(Failure.UNREACHABLE)
    start = low
    if not clear_of_target(attempt.situation, hand_footprint(opening, grip, p), pose, CLEAR_M):
        start = attempt.situation.target.spec.height_m + p.approach_clearance_m - lowest_point(grip)
    if start > low:
        fall = profile(start - low, p.descend_speed_m_s, tick, p.ramp_share)
        down = line(hand.arm.base, (x, y, start), (x, y, low), yaw, fall, tick, symmetric, p)
        down.positions[:, 6] += across.positions[0, 6] - down.positions[-1, 6]
        hand.arm.reset(down.positions[0], opening)
        take_tool(attempt, pose, start)
        attempt.descend([down])
    else:
        hand.arm.reset(across.positions[0], opening)
        take_tool(attempt, pose, start)

    start_x = world.pose(attempt.target)[0]
    for row in range(len(across.velocities)):
        attempt.command([across], row)
        attempt.step(p.control_every)
        if row % (POLL_EVERY // p.control_every) == 0:
            attempt.touched()
    settle(attempt)
    judge(attempt, start_x)


def take_tool(attempt: Attempt, pose: tuple[float, float, float], height_m: float) -> None:
    """Put the held tools into the hands, at rest, and let the grip settle."""
    p, world = attempt.parameters, attempt.world
    for hand in attempt.hands:
        if hand.grip is None:
            continue
        x, y, yaw = pose
        c, s = math.cos(yaw), math.sin(yaw)
        grip = hand.grip
        hand.tool = world.place(
            grip.spec,
            x + c * grip.x_m - s * grip.y_m,
            y + s * grip.x_m + c * grip.y_m,
            height_m + grip.z_m,
            yaw + grip.yaw_rad,
        )
        attempt.allowed = (hand.tool,)
        hand.arm.close_fingers()
        attempt.step(p.grip_settle_steps)
        if not attempt.tools_held():
            raise Ended(Failure.TOOL_LOST)


def settle(attempt: Attempt) -> None:
    """Wait, a bounded number of steps, until the target is at rest."""
    for _ in range(attempt.parameters.settle_steps // POLL_EVERY):
        if attempt.world.speed(attempt.target) < attempt.parameters.rest_speed_m_s:
            return
        attempt.step(POLL_EVERY)


def judge(attempt: Attempt, start_x_m: float) -> None:
    """Success is a displacement of at least 10 cm in +x, at the end, with every tool still in hand."""
    p, world, evidence = attempt.parameters, attempt.world, attempt.evidence
    evidence.displacement_m = world.pose(attempt.target)[0] - start_x_m
    if not attempt.tools_held():
        raise Ended(Failure.TOOL_LOST)
    if evidence.displacement_m < p.push_success_m:
        raise Ended(Failure.TOO_LITTLE if evidence.contact_steps else Failure.MISSED)
