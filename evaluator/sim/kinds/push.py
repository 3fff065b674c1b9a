"""Push with the closed gripper: down at p, 30 cm in +x."""

from __future__ import annotations

from evaluator.sim.attempt import CLEAR_M, POLL_EVERY, Attempt, AttemptFailed
from evaluator.sim.kinds.primitives import PushKind
from evaluator.sim.motion import line, profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import gap, swept
from evaluator.sim.shapes import footprint
from evaluator.sim.staging import Pose
from rema_data.schema import Embodiment, Failure, Primitive, Situation, StepKind

__all__ = ["Push"]


class Push(PushKind):
    """A push of one hand, with closed bare fingers."""

    step = StepKind(Primitive.PUSH, Embodiment.GRIPPER)
    acting, touching = "the gripper", "the fingers"
    symmetric = True
    margin_m = CLEAR_M
    """What passes the target farther away than this can't touch it."""

    def openings(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        return (0.0,)

    def low_m(self, situation: Situation, p: WorldParameters) -> float:
        """Height of the tool centre point while it pushes."""
        return p.push_height_m

    def speed_m_s(self, p: WorldParameters) -> float:
        """How fast the hand goes between its ramps."""
        return p.push_speed_m_s

    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        return (p.push_height_m,)

    def can_touch(self, situation: Situation, pose: Pose, p: WorldParameters) -> bool:
        """Hand and tool sweep rectangles on their way along +x."""
        covered = [swept(rect.moved(*pose), p.push_distance_m) for rect in self.footprint(situation, p)]
        return gap(covered, footprint(situation.target)) <= self.margin_m

    def carry_out(self, attempt: Attempt, pose: Pose) -> None:
        """Push from (x, y, yaw)."""
        p, world, (hand,) = attempt.parameters, attempt.world, attempt.hands
        situation, tick = attempt.situation, attempt.tick_s
        x, y, yaw = pose
        low = self.low_m(situation, p)
        shares = profile(p.push_distance_m, self.speed_m_s(p), tick, p.ramp_share)
        ends = (x, y, low), (x + p.push_distance_m, y, low)
        across = line(hand.arm.base, *ends, yaw, shares, tick, self.symmetric, p)
        if not across.reachable:
            raise AttemptFailed(Failure.UNREACHABLE)
        self.approach(attempt, pose, low, across)
        start_x = world.pose(attempt.target)[0]
        for row, target in enumerate(across.targets()):
            hand.arm.follow(*target)
            attempt.step(p.control_every)
            if row % (POLL_EVERY // p.control_every) == 0:
                attempt.touched()
        self.settle(attempt)
        self.check_moved(attempt, start_x)
