"""Grasp with two sticks: both arms close on the target with the tips of their sticks, then lift it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from evaluator.sim.attempt import CLEAR_M, CLEAR_TOOL_M, Attempt, AttemptFailed, relative
from evaluator.sim.footprints import clear_of_target, inner_extents, pair_heights
from evaluator.sim.kinds.base import TOOL_HEIGHTS_M, Flags
from evaluator.sim.kinds.pair import Squeeze, TwoArms, command, pair_frame, pair_path, sticks_of
from evaluator.sim.kinds.primitives import GraspKind
from evaluator.sim.motion import profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import gap, swept
from evaluator.sim.shapes import boxes, footprint
from evaluator.sim.staging import Pose
from rema_data import grid
from rema_data.schema import Embodiment, Failure, Pinch, Placement, Primitive, Situation, StepKind

__all__ = ["Pincer"]

MAX_HALF_M = 0.035
"""Half the thickness up to which the reference policy pinches a bar."""


class Pincer(TwoArms, GraspKind):
    """A grasp between two sticks. Where it is not the last step of a task, the object becomes a tool squared."""

    step = StepKind(Primitive.GRASP, Embodiment.STICKS)
    acting, touching, role = "two sticks", "the two held sticks", "tool"

    def distances(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        left, right = inner_extents(situation.grips)
        opened = 0.0 if closed else p.pair_open_m
        return left + opened, right + opened

    def heights(self, situation: Situation, p: WorldParameters) -> tuple[float, ...]:
        return pair_heights(situation.grips, p.pair_clearance_m)

    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        return *TOOL_HEIGHTS_M, TOOL_HEIGHTS_M[1] + p.pair_lift_height_m

    def success_lift_m(self, p: WorldParameters) -> float:
        return p.pair_success_lift_m

    def can_touch(self, situation: Situation, pose: Pose, p: WorldParameters) -> bool:
        """Sticks and hands sweep rectangles while they close."""
        hands = zip(self.sides, self.footprints(situation, False, p), strict=True)
        way = p.pair_open_m - p.pair_empty_m
        covered = [swept(rect, -side * way).moved(*pose) for side, rects in hands for rect in rects]
        return gap(covered, footprint(situation.target)) <= CLEAR_TOOL_M

    def carry_out(self, attempt: Attempt, pose: Pose) -> Pinch | None:
        """Close on the target at (x, y, theta), and lift it."""
        p, world, situation = attempt.parameters, attempt.world, attempt.situation
        x, y, theta = pose
        opened, heights = self.distances(situation, False, p), self.heights(situation, p)

        # Closing: each row brings the tips one tick nearer
        travel = np.arange(0.0, p.pair_open_m - p.pair_empty_m, p.pair_closing_speed_m_s * attempt.tick_s)
        here = np.tile([x, y, 0.0], (len(travel), 1))
        closing = pair_path(attempt, here, theta, (opened[0] - travel, opened[1] - travel), heights)
        lift = profile(p.pair_lift_height_m, p.pair_lift_speed_m_s, attempt.tick_s, p.ramp_share)
        rise = np.stack([np.full_like(lift, x), np.full_like(lift, y), p.pair_lift_height_m * lift], axis=1)

        start = 0.0
        if not clear_of_target(situation, self.footprint(situation, p), pose, CLEAR_M):
            start = self.start_height(situation, p.approach_clearance_m) - p.pair_clearance_m
        down = self.lower(attempt, pose, start, closing)
        attempt.allowed = sticks_of(attempt)
        attempt.step(p.grip_settle_steps)
        if down is not None:
            attempt.descend(down.of_each_hand())

        squeeze = Squeeze(attempt.target)
        contact = None
        for row in range(1, len(travel)):
            command(attempt, closing, row, 0.0)
            attempt.step(p.control_every)
            left, right = squeeze.forces(attempt)
            if left > 0 or right > 0:
                attempt.evidence.contact_steps += 1
            if min(left, right) >= p.pair_contact_n:
                contact = row
                break
        if contact is None:
            raise AttemptFailed(Failure.NOT_LIFTED if attempt.evidence.contact_steps else Failure.MISSED)

        distances = (opened[0] - travel[contact], opened[1] - travel[contact])
        up = pair_path(attempt, rise, theta, distances, heights)
        squeeze.hold(attempt, up, 0, p.pair_squeeze_steps)
        rest_z = situation.target.spec.height_m / 2
        try:
            squeeze.carry(attempt, up, Failure.NOT_LIFTED, lambda: attempt.note_lift(rest_z))
            squeeze.hold(attempt, up, len(lift) - 1, p.hold_steps)
        except AttemptFailed as failed:
            raise self.dropped(attempt) if failed.failure is Failure.NOT_LIFTED else failed from None
        height = world.pose(attempt.target)[2] - rest_z
        if not attempt.tools_held():
            raise AttemptFailed(Failure.TOOL_LOST)
        if height < p.pair_success_lift_m or min(squeeze.forces(attempt)) <= 0:
            raise self.dropped(attempt)
        if situation.last:
            return None
        if world.tilt(attempt.target) > p.max_tool_tilt_rad:
            raise AttemptFailed(Failure.TOOL_LOST)
        left_m, right_m, frame = pair_frame(attempt, theta)
        return Pinch(situation.target.spec, *relative(world.pose(attempt.target), frame), left_m, right_m)

    def candidates(
        self, target: Placement, valid: Flags, rng: np.random.Generator, p: WorldParameters
    ) -> Iterator[int]:
        """Across a bar near the centre of mass: at most two, the best aligned first."""
        ranked: list[tuple[float, int]] = []
        for bar in boxes(target.spec):
            placed = bar.moved(target.x_m, target.y_m, target.yaw_rad)
            for across in (0.0, math.pi / 2):
                theta = (placed.yaw + across) % math.pi
                k = round(theta / (2 * math.pi / grid.ANGLES)) % grid.PAIR_ANGLES
                thickness = placed.half_x if across == 0.0 else placed.half_y
                error = abs((theta - k * 2 * math.pi / grid.ANGLES + math.pi / 2) % math.pi - math.pi / 2)
                # aim at the point of the bar nearest to the centre of mass
                c, s = math.cos(placed.yaw), math.sin(placed.yaw)
                dx, dy = target.x_m - placed.x, target.y_m - placed.y
                along = max(-placed.half_x, min(placed.half_x, c * dx + s * dy))
                side = max(-placed.half_y, min(placed.half_y, c * dy - s * dx))
                along, side = (along, 0.0) if across else (0.0, side)
                x, y = placed.x + c * along - s * side, placed.y + s * along + c * side
                action = int(grid.snap(x, y, k * 2 * math.pi / grid.ANGLES))
                if valid[action] and thickness < MAX_HALF_M:
                    far = math.hypot(x - target.x_m, y - target.y_m)
                    ranked.append((error + 10 * thickness + 5 * far, action))
        return iter([action for _, action in sorted(ranked)[:2]])
