"""Situation + action -> outcome: a pure function, computed by Bullet only where something can touch."""

from __future__ import annotations

import math
from functools import cache

from evaluator.sim.attempt import Attempt, AttemptFailed, Hand
from evaluator.sim.kinds import kind_of
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.reach import acting_arm
from evaluator.sim.staging import Pose, target_thing
from evaluator.sim.world import Unstable, World
from rema_data.schema import Action, Evidence, Failure, Grip, Pinch, Situation, StepOutcome


class Simulator:
    """Carries out single steps. One per process; the same step gives the same outcome in any order and any process.

    With ``shortcuts``, actions that provably cannot touch the target are labelled ``missed`` without simulation.
    """

    def __init__(self, parameters: WorldParameters = WORLD, *, shortcuts: bool = True) -> None:
        self.parameters, self._shortcuts = parameters, shortcuts
        self._world: World | None = None

    def run(self, situation: Situation, action: int) -> StepOutcome:
        """Outcome of one action, a grid index in 0..65535."""
        arm = acting_arm(situation.task, situation.step, action, self.parameters)
        if arm is None:
            return StepOutcome(False, Failure.UNREACHABLE)
        pose = Action(action).pose
        if self._shortcuts and not kind_of(situation).can_touch(situation, pose, self.parameters):
            return StepOutcome(False, Failure.MISSED, arm=arm)
        self.world.begin(("left", "right") if arm == "both" else (arm,))
        return self._attempt(situation, pose, arm)

    @property
    def world(self) -> World:
        """The one world, as the last simulated step left it."""
        if self._world is None:
            self._world = World(("left",), self.parameters)
        return self._world

    def close(self) -> None:
        """Disconnect from Bullet."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def _attempt(self, situation: Situation, pose: Pose, arm: str) -> StepOutcome:
        kind, world = kind_of(situation), self.world
        body = world.put(target_thing(situation))
        bodies = tuple(arm.body for arm in world.arms.values())
        grips = kind.grips(situation) or (None,) * len(bodies)
        hands = [Hand(arm, grip) for arm, grip in zip(world.arms.values(), grips, strict=True)]
        allowed, forbidden = (bodies, ()) if kind.bare else ((), bodies)
        attempt = Attempt(world, situation, hands, body, allowed, forbidden, Evidence(arm=arm))
        failure: Failure | None = None
        made: Grip | Pinch | None = None
        try:
            made = kind.carry_out(attempt, pose)
        except AttemptFailed as failed:
            failure = failed.failure
        try:
            world.check(body)
        except Unstable:
            failure, made = Failure.UNSTABLE, None
        attempt.note(sim_steps=world.steps)
        measured = attempt.evidence.evidence()
        if not all(math.isfinite(value) for value in measured.values() if isinstance(value, float)):
            return StepOutcome(False, Failure.UNSTABLE, arm=arm, sim_steps=world.steps)
        grip = made if isinstance(made, Grip) else None
        pinch = made if isinstance(made, Pinch) else None
        return StepOutcome(failure is None, failure, grip=grip, pinch=pinch, **measured)


@cache
def process_simulator() -> Simulator:
    """The one simulator of a worker process, open until it ends."""
    return Simulator()
