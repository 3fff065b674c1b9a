"""Situation + action -> outcome: a pure function, computed by Bullet only where something can touch."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

from evaluator.sim.attempt import Attempt, AttemptFailed, Hand
from evaluator.sim.kinds import kind_of
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.reach import acting_arm
from evaluator.sim.staging import Pose, target_thing, turned
from evaluator.sim.varied import aimed_at, executed, parameters_of
from evaluator.sim.world import Unstable, World
from rema_data.schema import Action, Failure, Grip, Pinch, Situation, StepOutcome


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
        parameters = parameters_of(situation, self.parameters)
        pose = executed(situation, Action(action).pose)
        situation = aimed_at(situation, pose, parameters)
        if self._shortcuts and not _can_meet(situation, pose, parameters):
            return StepOutcome(False, Failure.MISSED, arm=arm)
        self.world.use(parameters)
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
        body, loose, posts = _set_out(world, situation)
        bodies = tuple(arm.body for arm in world.arms.values())
        grips = kind.grips(situation) or (None,) * len(bodies)
        hands = [Hand(arm, grip) for arm, grip in zip(world.arms.values(), grips, strict=True)]
        allowed, forbidden = (bodies, ()) if kind.bare else ((), bodies)
        attempt = Attempt(world, situation, hands, body, allowed, forbidden, loose=loose, posts=posts)
        failure: Failure | None = None
        made: Grip | Pinch | None = None
        try:
            made = kind.carry_out(attempt, pose)
            attempt.check_alone()
        except AttemptFailed as failed:
            failure = failed.failure
        try:
            world.check(body, *loose)
        except Unstable:
            failure, made = Failure.UNSTABLE, None
        measured = {**vars(attempt.evidence), "arm": arm, "sim_steps": world.steps}
        if not all(math.isfinite(value) for value in measured.values() if isinstance(value, float)):
            return StepOutcome(False, Failure.UNSTABLE, arm=arm, sim_steps=world.steps)
        grip = made if isinstance(made, Grip) else None
        pinch = made if isinstance(made, Pinch) else None
        return StepOutcome(failure is None, failure, grip=grip, pinch=pinch, **measured)


def _set_out(world: World, situation: Situation) -> tuple[int, tuple[int, ...], tuple[int, ...]]:
    """Put everything on the table: the bodies of the target, of other loose objects and of posts."""
    variation, (_, spec, x, y, z, yaw) = situation.variation, target_thing(situation)
    if variation is None:
        return world.place(spec, x, y, z, yaw), (), ()
    dx, dy = turned((0.0, 0.0, yaw), *variation.mass_offset_m)
    body = world.place(spec, x + dx, y + dy, z, yaw, mass_offset_m=variation.mass_offset_m)
    loose, posts = (
        tuple(
            world.place(one.spec, one.x_m, one.y_m, one.spec.height_m / 2, one.yaw_rad, fixed=fixed) for one in things
        )
        for things, fixed in ((variation.others, False), (variation.posts, True))
    )
    return body, loose, posts


def _can_meet(situation: Situation, pose: Pose, p: WorldParameters) -> bool:
    """Whether an action could touch the target, or anything else that stands on the table."""
    kind, variation = kind_of(situation), situation.variation
    if kind.can_touch(situation, pose, p):
        return True
    # what is met on the way to nothing is missed all the same, but a post must not be touched
    return variation is not None and any(
        kind.can_touch(dataclasses.replace(situation, target=post), pose, p) for post in variation.posts
    )


@cache
def process_simulator() -> Simulator:
    """The one simulator of a worker process, open until it ends."""
    return Simulator()
