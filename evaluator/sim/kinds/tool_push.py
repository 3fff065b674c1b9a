"""Push with a held tool: as with the gripper, the tool's lowest point just above the table."""

from __future__ import annotations

from evaluator.sim.attempt import CLEAR_TOOL_M, Attempt, AttemptFailed
from evaluator.sim.footprints import lowest_point
from evaluator.sim.kinds.base import TOOL_HEIGHTS_M
from evaluator.sim.kinds.push import Push
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.staging import Pose
from rema_data.schema import Embodiment, Failure, Primitive, Situation, StepKind

__all__ = ["ToolPush"]


class ToolPush(Push):
    """A push of one hand with the tool in it."""

    step = StepKind(Primitive.PUSH, Embodiment.TOOL)
    acting, touching, role = "a tool", "the held tool", "tool"
    symmetric = False
    margin_m = CLEAR_TOOL_M

    def openings(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        return (situation.grips[0].opening_m,)

    def low_m(self, situation: Situation, p: WorldParameters) -> float:
        return p.tool_clearance_m - lowest_point(situation.grips[0])

    def start_height(self, situation: Situation, clearance_m: float) -> float:
        return super().start_height(situation, clearance_m) - lowest_point(situation.grips[0])

    def speed_m_s(self, p: WorldParameters) -> float:
        return p.tool_push_speed_m_s

    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        return TOOL_HEIGHTS_M

    def take(self, attempt: Attempt, pose: Pose, height_m: float) -> None:
        """Put the tool into the hand, at rest, and let the grip settle."""
        p, (hand,) = attempt.parameters, attempt.hands
        (tool,) = self.held(attempt.situation, self.hands(attempt.situation, pose, height_m, p=p), pose)
        hand.tool = attempt.world.put(tool)
        attempt.allowed = (hand.tool,)
        hand.arm.close_fingers()
        attempt.step(p.grip_settle_steps)
        if not attempt.tools_held():
            raise AttemptFailed(Failure.TOOL_LOST)
