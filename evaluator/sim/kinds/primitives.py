"""What all grasps share, and what all pushes share."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from evaluator.sim.attempt import POLL_EVERY, Attempt, AttemptFailed
from evaluator.sim.kinds.base import Kind
from evaluator.sim.parameters import WORLD, WorldParameters
from rema_data.schema import Failure, Placement

__all__ = ["GraspKind", "PushKind"]


class GraspKind(Kind):
    """A step that lifts the target."""

    measure = "lift_m"
    closes = True

    def reach_shifts(self, p: WorldParameters) -> tuple[float, ...]:
        return (0.0,)

    @abstractmethod
    def success_lift_m(self, p: WorldParameters) -> float:
        """How high the target has to be."""

    def dropped(self, attempt: Attempt) -> AttemptFailed:
        """The failure of a target that is not held any more: by how far it was lifted."""
        lifted = attempt.evidence.lift_m > attempt.parameters.slip_lift_m
        return AttemptFailed(Failure.SLIPPED if lifted else Failure.NOT_LIFTED)

    def goal(self, p: WorldParameters) -> str:
        return (
            f"{p.hold_steps} simulation steps after the lift, the target's centre of mass is at least "
            f"{self.success_lift_m(p):g} m higher than on the table, and the target is still held"
        )

    def spawn(self, rng: np.random.Generator, p: WorldParameters) -> tuple[float, float]:
        x, y = (float(value) for value in rng.uniform(-p.grasp_spawn_half_m, p.grasp_spawn_half_m, 2))
        return x, y


class PushKind(Kind):
    """A step that moves the target in +x; it starts further to +x, with room behind it."""

    measure = "displacement_m"

    def reach_shifts(self, p: WorldParameters) -> tuple[float, ...]:
        return 0.0, p.push_distance_m / 2, p.push_distance_m

    def goal(self, p: WorldParameters) -> str:
        return f"at rest, the target's centre of mass is at least {p.push_success_m:g} m further in +x than before"

    def spawn(self, rng: np.random.Generator, p: WorldParameters) -> tuple[float, float]:
        x = float(rng.uniform(p.push_spawn_x_min_m, p.push_spawn_x_max_m))
        return x, float(rng.uniform(-p.push_spawn_half_y_m, p.push_spawn_half_y_m))

    def aim(self, target: Placement, p: WorldParameters = WORLD) -> tuple[float, float]:
        return target.x_m - p.scripted_push_offset_m, target.y_m

    def settle(self, attempt: Attempt) -> None:
        """Wait, a bounded number of steps, until the target is at rest."""
        for _ in range(attempt.parameters.settle_steps // POLL_EVERY):
            if attempt.world.speed(attempt.target) < attempt.parameters.rest_speed_m_s:
                return
            attempt.step(POLL_EVERY)

    def check_moved(self, attempt: Attempt, start_x_m: float) -> None:
        """Fail the attempt unless the target moved far enough in +x and every tool is still in hand."""
        moved = attempt.world.pose(attempt.target)[0] - start_x_m
        attempt.evidence.displacement_m = moved
        if not attempt.tools_held():
            raise AttemptFailed(Failure.TOOL_LOST)
        if moved < attempt.parameters.push_success_m:
            raise AttemptFailed(Failure.TOO_LITTLE if attempt.evidence.contact_steps else Failure.MISSED)
