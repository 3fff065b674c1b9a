"""Push with a tool squared: an object pinched between two sticks is carried 30 cm in +x."""

from __future__ import annotations

import numpy as np

from evaluator.sim.attempt import CLEAR_M, POLL_EVERY, Attempt, AttemptFailed, relative
from evaluator.sim.footprints import clear_of_target, pair_heights
from evaluator.sim.kinds.base import TOOL_HEIGHTS_M
from evaluator.sim.kinds.pair import PairPath, Squeeze, TwoArms, pair_frame, pair_path, sticks_of
from evaluator.sim.kinds.primitives import PushKind
from evaluator.sim.motion import profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect
from evaluator.sim.shapes import boxes
from evaluator.sim.staging import HandPose, Part, Pose, Thing, turned
from rema_data.schema import Embodiment, Failure, Pinch, Primitive, Situation, StepKind

__all__ = ["PinchedPush"]


class PinchedPush(TwoArms, PushKind):
    """A push of two hands with what they pinched before."""

    step = StepKind(Primitive.PUSH, Embodiment.PINCHED)
    acting, touching, role = "a pinched object", "the pinched object", "held"
    tools_touch = False

    def distances(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        pinch = _pinch(situation)
        return pinch.left_m, pinch.right_m

    def heights(self, situation: Situation, p: WorldParameters) -> tuple[float, ...]:
        """As they pinched, and the whole lowered until its lowest point is at the clearance."""
        pinch, heights = _pinch(situation), pair_heights(situation.grips, p.pair_clearance_m)
        bottom = min(min(heights) + pinch.z_m - pinch.spec.height_m / 2, p.pair_clearance_m)
        shift = p.pinched_clearance_m - bottom
        return heights[0] + shift, heights[1] + shift

    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        return TOOL_HEIGHTS_M

    def held(self, situation: Situation, hands: list[HandPose], pose: Pose) -> list[Thing]:
        pinch = _pinch(situation)
        x, y = turned(pose, pinch.x_m, pinch.y_m)
        z = min(hand.z_m for hand in hands) + pinch.z_m
        return [*super().held(situation, hands, pose), Thing("held", pinch.spec, x, y, z, pose[2] + pinch.yaw_rad)]

    def footprint(self, situation: Situation, p: WorldParameters) -> list[Rect]:
        return super().footprint(situation, p) + _pinched(_pinch(situation))

    def parts(self, situation: Situation, closed: bool, p: WorldParameters) -> list[Part]:
        pinch = _pinch(situation)
        bottom = min(self.heights(situation, p)) + pinch.z_m - pinch.spec.height_m / 2
        return super().parts(situation, closed, p) + [
            Part(rect, bottom, bottom + pinch.spec.height_m, True) for rect in _pinched(pinch)
        ]

    def can_touch(self, situation: Situation, pose: Pose, p: WorldParameters) -> bool:
        """Always true: the pinch may be lost on the way, which only a simulation shows."""
        return True

    def carry_out(self, attempt: Attempt, pose: Pose) -> None:
        """Push from (x, y, theta)."""
        p, world, situation = attempt.parameters, attempt.world, attempt.situation
        pinch = _pinch(situation)
        x, y, theta = pose
        shares = profile(p.push_distance_m, p.pinched_push_speed_m_s, attempt.tick_s, p.ramp_share)
        way = np.stack([x + p.push_distance_m * shares, np.full_like(shares, y), np.zeros_like(shares)], axis=1)
        across = pair_path(attempt, way, theta, self.distances(situation, False, p), self.heights(situation, p))

        start = 0.0
        if not clear_of_target(situation, self.footprint(situation, p), pose, CLEAR_M):
            start = self.start_height(situation, p.approach_clearance_m) - p.pinched_clearance_m
        down = self.lower(attempt, pose, start, across)
        held = world.put(self.held(situation, self.hands(situation, pose, start, p=p), pose)[-1])
        attempt.allowed, attempt.forbidden = (held,), (*attempt.forbidden, *sticks_of(attempt))
        squeeze = Squeeze(held, p.pair_max_correction_m)
        if squeeze.hold(attempt, across if down is None else down, 0, p.pair_squeeze_steps) <= 0:
            raise AttemptFailed(Failure.TOOL_LOST)
        if down is not None:
            _descend_squeezing(attempt, down, squeeze)
        start_x = world.pose(attempt.target)[0]
        ticks = 0

        def watch() -> None:
            nonlocal ticks
            ticks += 1
            if ticks % (POLL_EVERY // p.control_every) == 0:
                attempt.touched()

        squeeze.carry(attempt, across, Failure.TOOL_LOST, watch)
        squeeze.hold(attempt, across, len(shares) - 1, POLL_EVERY * 4)
        self.settle(attempt)
        _, _, frame = pair_frame(attempt, theta)
        if min(squeeze.forces(attempt)) <= 0 or not attempt.unmoved(relative(world.pose(held), frame), pinch):
            raise AttemptFailed(Failure.TOOL_LOST)
        self.check_moved(attempt, start_x)


def _pinch(situation: Situation) -> Pinch:
    assert situation.pinch is not None
    return situation.pinch


def _pinched(pinch: Pinch) -> list[Rect]:
    """Footprint of the pinched object in the pair frame."""
    return [box.moved(pinch.x_m, pinch.y_m, pinch.yaw_rad) for box in boxes(pinch.spec)]


def _descend_squeezing(attempt: Attempt, path: PairPath, squeeze: Squeeze) -> None:
    """Move down without losing the object, and end the attempt if anything lands on the target (protective stop)."""

    def watch() -> None:
        bodies = (*attempt.allowed, *attempt.forbidden)
        if attempt.too_much(sum(attempt.world.force(body, attempt.target) for body in bodies)):
            raise AttemptFailed(Failure.BLOCKED)

    squeeze.carry(attempt, path, Failure.TOOL_LOST, watch)
