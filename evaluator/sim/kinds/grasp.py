"""Grasp with the gripper: down at p, close, up to 30 cm above p."""

from __future__ import annotations

from evaluator.sim.attempt import Attempt, Ended, relative
from evaluator.sim.footprints import clear_of_target, hand_footprint
from evaluator.sim.motion import line, profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import footprint
from rema_data.schema import Failure, Grip, Situation

POLL_EVERY = 4
"""Simulation steps between two looks at the carried object."""
CLEAR_M = 0.002
"""Footprints farther apart than this can't touch during a straight descent."""


def can_touch(situation: Situation, pose: tuple[float, float, float], parameters: WorldParameters) -> bool:
    """Whether the hand could touch the target at all: descending open and closing sweep one rectangle."""
    half_x = parameters.opening_max_m / 2 + parameters.finger_thickness_m
    swept = Rect(0, 0, 0, half_x, parameters.finger_lateral_m / 2)
    return gap([swept.moved(*pose)], footprint(situation.target)) <= CLEAR_M


def grasp(attempt: Attempt, pose: tuple[float, float, float]) -> Grip | None:
    """Carry out a grasp at (x, y, yaw); raises Ended where it fails.

    Returns
    -------
    Grip or None
        The object as a tool in the hand, if this step is not the task's last.
    """
    p, world, (hand,) = attempt.parameters, attempt.world, attempt.hands
    x, y, yaw = pose
    low = p.grasp_height_m
    tick = p.time_step_s * p.control_every
    opening = p.opening_max_m
    start = low
    if not clear_of_target(attempt.situation, hand_footprint(opening, None, p), pose, CLEAR_M):
        start = attempt.situation.target.spec.height_m + p.approach_clearance_m
    lift = profile(p.lift_height_m, p.lift_speed_m_s, tick, p.ramp_share)
    up = line(hand.arm.base, (x, y, low), (x, y, low + p.lift_height_m), yaw, lift, tick, True, p)
    if not up.reachable:
        raise Ended(Failure.UNREACHABLE)
    if start > low:
        shares = profile(start - low, p.descend_speed_m_s, tick, p.ramp_share)
        down = line(hand.arm.base, (x, y, start), (x, y, low), yaw, shares, tick, True, p)
        hand.arm.reset(down.positions[0], opening)
        attempt.descend([down])
    else:
        hand.arm.reset(up.positions[0], opening)

    close(attempt)
    if hand.arm.fingers()[0] < p.empty_opening_m:
        raise Ended(Failure.NOT_LIFTED if attempt.evidence.contact_steps else Failure.MISSED)

    rest_z = world.pose(attempt.target)[2]
    lost = 0
    for row in range(len(up.velocities)):
        attempt.command([up], row)
        attempt.step(p.control_every)
        if row % (POLL_EVERY // p.control_every) == 0:
            attempt.evidence.lift_m = max(attempt.evidence.lift_m, world.pose(attempt.target)[2] - rest_z)
            lost = 0 if attempt.touched() else lost + 1
            if lost * POLL_EVERY == p.lost_steps:  # out of a rising hand's reach for good
                raise _dropped(attempt)
    attempt.step(p.hold_steps)
    height = world.pose(attempt.target)[2] - rest_z
    attempt.evidence.lift_m = max(attempt.evidence.lift_m, height)
    if height < p.grasp_success_lift_m or not attempt.touched():
        raise _dropped(attempt)
    if attempt.situation.last:
        return None
    if world.tilt(attempt.target) > p.max_tool_tilt_rad:
        raise Ended(Failure.TOOL_LOST)
    gx, gy, gz, gyaw = relative(world.pose(attempt.target), hand.arm.hand_pose())
    return Grip(attempt.situation.target.spec, gx, gy, gz, gyaw, hand.arm.fingers()[0])


def close(attempt: Attempt) -> None:
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


def _dropped(attempt: Attempt) -> Ended:
    return Ended(Failure.SLIPPED if attempt.evidence.lift_m > attempt.parameters.slip_lift_m else Failure.NOT_LIFTED)
