"""Push with a tool squared: an object pinched between two sticks is carried 30 cm in +x."""

from __future__ import annotations

import math

import numpy as np

from evaluator.sim.attempt import Attempt, Ended, relative, wrap
from evaluator.sim.footprints import clear_of_target, pinched_footprint, pinched_heights
from evaluator.sim.kinds.grasp import CLEAR_M
from evaluator.sim.kinds.pair import PairPath, Squeeze, lower, pair_path
from evaluator.sim.kinds.pincer import pair_frame
from evaluator.sim.kinds.push import POLL_EVERY, judge, settle
from evaluator.sim.motion import profile
from rema_data.schema import Failure


def push_pinched(attempt: Attempt, pose: tuple[float, float, float]) -> None:
    """Push the target 30 cm in +x with an object pinched between two sticks; raises Ended where it fails."""
    p, world = attempt.parameters, attempt.world
    pinch, grips = attempt.situation.pinch, attempt.situation.grips
    assert pinch is not None
    x, y, theta = pose
    distances = (pinch.left_m, pinch.right_m)
    heights = pinched_heights(grips, pinch, p)
    tick = p.time_step_s * p.control_every
    shares = profile(p.push_distance_m, p.pinched_push_speed_m_s, tick, p.ramp_share)
    way = np.stack([x + p.push_distance_m * shares, np.full_like(shares, y), np.zeros_like(shares)], axis=1)
    across = pair_path(attempt, way, theta, distances, heights)

    start = 0.0
    if not clear_of_target(attempt.situation, pinched_footprint(grips, pinch, p), pose, CLEAR_M):
        start = attempt.situation.target.spec.height_m + p.approach_clearance_m - p.pinched_clearance_m
    down = lower(attempt, pose, start, across, distances, heights)
    path = across if down is None else down
    c, s = math.cos(theta), math.sin(theta)
    held = world.place(
        pinch.spec,
        x + c * pinch.x_m - s * pinch.y_m,
        y + s * pinch.x_m + c * pinch.y_m,
        min(heights) + start + pinch.z_m,
        theta + pinch.yaw_rad,
    )
    sticks = tuple(hand.tool for hand in attempt.hands if hand.tool is not None)
    attempt.allowed, attempt.forbidden = (held,), (*attempt.forbidden, *sticks)
    squeeze = Squeeze(held, p.pair_max_correction_m)
    if squeeze.hold(attempt, path, 0, p.pair_squeeze_steps) <= 0:
        raise Ended(Failure.TOOL_LOST)
    if down is not None:
        _descend_squeezing(attempt, down, squeeze)
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
