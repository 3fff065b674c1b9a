"""Situation + action -> outcome: a pure function, computed by Bullet only where something can touch."""

from __future__ import annotations

import math
from typing import Any

from evaluator.sim.attempt import Attempt, Ended, Hand
from evaluator.sim.kinds import grasp, pincer, pinched_push, push
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.reach import acting_arm, hand_yaws
from evaluator.sim.world import Unstable, World
from rema_data import grid
from rema_data.schema import Embodiment, Failure, Grip, Pinch, Primitive, Situation, StepOutcome


class Simulator:
    """Carries out single steps. One per process; the same step gives the same outcome in any order and any process.

    Parameters
    ----------
    parameters : WorldParameters
    shortcuts : bool
        Whether actions that provably cannot touch the target are labelled ``missed`` without simulation.
    meshes : str, optional
        pybullet_data folder: arms with visual meshes, for pictures. Physics is the same.
    """

    def __init__(
        self, parameters: WorldParameters = WORLD, *, shortcuts: bool = True, meshes: str | None = None
    ) -> None:
        self.parameters, self._shortcuts, self._meshes = parameters, shortcuts, meshes
        self._world: World | None = None

    def run(self, situation: Situation, action: int) -> StepOutcome:
        """Outcome of one action.

        Parameters
        ----------
        situation : Situation
        action : int
            Grid index, 0..65535.
        """
        arm = acting_arm(situation.task, situation.step, action, self.parameters)
        if arm is None:
            return StepOutcome(False, Failure.UNREACHABLE)
        x, y, theta = (float(value) for value in grid.to_world(action))
        if self._shortcuts and not self._can_touch(situation, (x, y, theta)):
            return StepOutcome(False, Failure.MISSED, arm=arm)
        self.world.begin(("left", "right") if arm == "both" else (arm,))
        return self._attempt(self.world, situation, (x, y, theta), arm)

    @property
    def world(self) -> World:
        """The one world, as the last simulated step left it."""
        if self._world is None:
            self._world = World(("left",), self.parameters, self._meshes)
        return self._world

    def close(self) -> None:
        """Disconnect from Bullet."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def _can_touch(self, situation: Situation, pose: tuple[float, float, float]) -> bool:
        kind, parameters = situation.kind, self.parameters
        if kind.embodiment is Embodiment.GRIPPER and kind.primitive is Primitive.GRASP:
            return grasp.can_touch(situation, pose, parameters)
        if kind.embodiment is Embodiment.PINCHED:
            return True  # the pinch may be lost on the way, and that label is not known beforehand
        if kind.embodiment is Embodiment.STICKS:
            return pincer.can_touch(situation, pose, parameters)
        return push.can_touch(situation, situation.grips[0] if situation.grips else None, pose, parameters)

    def _attempt(self, world: World, situation: Situation, pose: tuple[float, float, float], arm: str) -> StepOutcome:
        kind = situation.kind
        target = situation.target
        tool_use = kind.embodiment is not Embodiment.GRIPPER
        body = world.place(target.spec, target.x_m, target.y_m, target.spec.height_m / 2, target.yaw_rad)
        arms = list(world.arms.values())
        bodies = tuple(arm.body for arm in arms)
        grips: tuple[Grip | None, ...] = situation.grips if tool_use else (None,) * len(arms)
        hands = [Hand(arm, grip) for arm, grip in zip(arms, grips, strict=True)]
        attempt = Attempt(world, situation, hands, body, () if tool_use else bodies, bodies if tool_use else ())
        x, y, theta = pose
        yaw = float(hand_yaws(kind, theta)[0])
        failure: Failure | None = None
        grip: Grip | None = None
        pinch: Pinch | None = None
        try:
            if kind.embodiment is Embodiment.STICKS:
                pinch = pincer.pincer(attempt, pose)
            elif kind.embodiment is Embodiment.PINCHED:
                pinched_push.push_pinched(attempt, pose)
            elif kind.primitive is Primitive.GRASP:
                grip = grasp.grasp(attempt, (x, y, yaw))
            else:
                push.push(attempt, (x, y, yaw))
        except Ended as ended:
            failure = ended.failure
        try:
            world.check(body)
        except Unstable:
            failure, grip, pinch = Failure.UNSTABLE, None, None
        evidence: dict[str, Any] = {
            name: getattr(attempt.evidence, name)
            for name in ("displacement_m", "lift_m", "peak_force_n", "contact_steps", "illegal_steps")
        }
        if not all(math.isfinite(value) for value in evidence.values()):
            return StepOutcome(False, Failure.UNSTABLE, arm=arm, sim_steps=world.steps)
        return StepOutcome(failure is None, failure, arm=arm, sim_steps=world.steps, grip=grip, pinch=pinch, **evidence)
