"""Steps carried out before a camera: what the world looked like before, on the way, and at the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from evaluator.render.studio import Marker, Shot, shot_of_stage, shot_of_world
from evaluator.rollout.episode import walk
from evaluator.sim.kinds import kind_of
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import acting_arm
from evaluator.sim.simulator import Simulator
from evaluator.sim.staging import HandPose, Thing, target_thing
from evaluator.sim.varied import aimed_at, executed, parameters_of, standing
from evaluator.sim.world import World
from rema_data import grid
from rema_data.schema import Action, Failure, ObjectSpec, Scenario, Situation, StepOutcome

__all__ = ["SHOT_EVERY", "FilmMaker", "Take", "agreement", "markers", "waiting_shot"]

SHOT_EVERY = 6
"""Simulation steps between two shots."""
CLEARANCE_M = 0.09
"""How far above the target hands and tools wait in the picture before the action."""
_AIM = (0.12, 0.12, 0.14, 1.0)
_LINE = (0.05, 0.62, 0.20, 1.0)
_SQUARE = (0.66, 0.62, 0.56, 1.0)


@dataclass(frozen=True, slots=True)
class Take:
    """A step that was carried out."""

    situation: Situation
    action: int  # grid index
    outcome: StepOutcome
    before: Shot  # hands above the place of the action
    shots: Sequence[Shot]  # one every ``SHOT_EVERY`` simulation steps, and the end; empty where no arm moved

    @property
    def after(self) -> Shot:
        """The moment in which the attempt ended; ``before`` where no arm moved."""
        return self.shots[-1] if self.shots else self.before


class FilmMaker:
    """Carries out steps, as a context manager. Needs one Bullet client, and no policy."""

    def __init__(self) -> None:
        self._simulator = _Filming(shortcuts=True)
        self._slow = _Filming(shortcuts=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._simulator.close()
        self._slow.close()

    def play(
        self, scenario: Scenario, protocol: str, choose: Callable[[Situation], int], until: int | None = None
    ) -> Take:
        """The step at which an episode ends, or the step ``until`` if earlier; ``choose`` gives a grid index."""
        for take in walk(scenario, protocol, lambda situation: self.take(situation, choose(situation))):
            if take.situation.step == until:
                break
        return take

    def take(self, situation: Situation, action: int) -> Take:
        """One step."""
        before = waiting_shot(situation, action)
        if acting_arm(situation.task, situation.step, action) is None:
            return Take(situation, action, StepOutcome(False, Failure.UNREACHABLE), before, ())
        outcome, shots = self._simulator.film(situation, action)
        if not shots and outcome.failure is Failure.MISSED:
            _, shots = self._slow.film(situation, action)  # the outcome was clear without simulation
        return Take(situation, action, outcome, before, () if outcome.failure is Failure.UNREACHABLE else shots)


class _Filming(Simulator):
    """A simulator that keeps what its world looked like."""

    def film(self, situation: Situation, action: int) -> tuple[StepOutcome, list[Shot]]:
        """Outcome of one action, and shots of the way to it; none where nothing was simulated."""
        shots: list[Shot] = []
        world = self.world
        parameters = parameters_of(situation, self.parameters)
        cast = _roles(aimed_at(situation, executed(situation, Action(action).pose), parameters))
        offset = (0.0, 0.0) if situation.variation is None else situation.variation.mass_offset_m
        world.look = lambda: shots.append(shot_of_world(world, cast, offset))
        outcome = self.run(situation, action)
        if shots:
            world.look()  # the end
        return outcome, shots

    @property
    def world(self) -> _WatchedWorld:
        """The one world."""
        if not isinstance(self._world, _WatchedWorld):
            self._world = _WatchedWorld(("left",), self.parameters)
        return self._world


class _WatchedWorld(World):
    """A world that calls ``look`` every ``SHOT_EVERY`` steps; looking changes nothing."""

    look: Callable[[], None]

    def step(self, count: int = 1) -> None:
        """Advance by ``count`` steps."""
        for _ in range(count):
            if self.steps % SHOT_EVERY == 0:
                self.look()
            super().step()


def _roles(situation: Situation) -> list[tuple[str, ObjectSpec]]:
    """Objects of a simulated step, in the order in which the simulator places them: for ``shot_of_world``."""
    return [(thing.role, thing.spec) for thing in _staged(situation, 0, "left")[1]]


def waiting_shot(situation: Situation, action: int) -> Shot:
    """The picture before an action: what acts waits ``CLEARANCE_M`` above its place."""
    arm = acting_arm(situation.task, situation.step, action) or "left"
    return shot_of_stage(*_staged(situation, action, arm), kind_of(situation).symmetric)


def _staged(situation: Situation, action: int, arm: str) -> tuple[list[HandPose], list[Thing]]:
    """Hands that wait above the place of an action, and all objects: the target first, then what stands beside it."""
    kind, pose = kind_of(situation), Action(action).pose
    hands = kind.hands(situation, pose, kind.start_height(situation, CLEARANCE_M), arm)
    _, *beside = standing(situation)
    placed = [Thing("other", one.spec, one.x_m, one.y_m, one.spec.height_m / 2, one.yaw_rad) for one in beside]
    return hands, [target_thing(situation), *placed, *kind.held(situation, hands, pose)]


def markers(situation: Situation, action: int) -> list[Marker]:
    """Bars on the table: the valid square, the place of the action, and for a push its way and the line to pass."""
    x, y, yaw = Action(action).pose
    edge = grid.SCENE_HALF_M - grid.VALID_MARGIN * grid.PIXEL_M
    thin = 0.0012
    found = [Marker(s * edge, 0.0, thin, edge, 0.0, _SQUARE) for s in (-1, 1)]
    found += [Marker(0.0, s * edge, edge, thin, 0.0, _SQUARE) for s in (-1, 1)]
    way = kind_of(situation).reach_shifts(WORLD)[-1]
    if way:
        found.append(Marker(x + way / 2, y, way / 2, 0.0015, 0.0, _AIM))
        for turn in (-1, 1):
            tip = turn * math.radians(150)
            found.append(Marker(x + way + 0.014 * math.cos(tip), y + 0.014 * math.sin(tip), 0.015, 0.0015, tip, _AIM))
        target = situation.target
        found.append(Marker(target.x_m + WORLD.push_success_m, target.y_m, 0.003, 0.10, 0.0, _LINE))
    else:
        found += [Marker(x, y, 0.016, 0.0012, yaw, _AIM), Marker(x, y, 0.0012, 0.016, yaw, _AIM)]
    return found


def agreement(row: Mapping[str, Any], take: Take) -> str:
    """A replayed episode against its row of results: "identical", "same label" (other measurements) or "different"."""
    step = take.situation.step
    recorded = row[f"step{step}_success"], row[f"step{step}_failure"]
    label = None if take.outcome.failure is None else take.outcome.failure.value
    if recorded != (take.outcome.success, label):
        return "different"
    same = all(row.get(f"step{step}_{name}", value) == value for name, value in take.outcome.evidence().items())
    return "identical" if same else "same label"
