"""Episodes played again from their recorded actions, with what the world looked like on the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from evaluator.render.preview import roles, waiting_shot
from evaluator.render.studio import Shot, shot_of_world
from evaluator.report.finished import FinishedRun, Row
from evaluator.sim.reach import acting_arm
from evaluator.sim.simulator import Simulator
from evaluator.sim.world import World
from rema_data.schema import Failure, Scenario, Situation, StepOutcome

__all__ = ["SHOT_EVERY", "FilmMaker", "Take", "agreement"]

SHOT_EVERY = 6
"""Simulation steps between two shots."""


@dataclass(frozen=True, slots=True)
class Take:
    """The step that decided an episode, carried out again.

    Attributes
    ----------
    situation : Situation
    action : int
        Grid index.
    outcome : StepOutcome
        Of this time.
    before : Shot
        Hands above the place of the action.
    shots : sequence of Shot
        One every ``SHOT_EVERY`` simulation steps, and the end; empty where no arm moved.
    """

    situation: Situation
    action: int
    outcome: StepOutcome
    before: Shot
    shots: Sequence[Shot]


class FilmMaker:
    """Plays episodes again, as a context manager. Needs one Bullet client, and no policy."""

    def __init__(self) -> None:
        self._simulator = _Filming(shortcuts=True)
        self._slow = _Filming(shortcuts=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._simulator.close()
        self._slow.close()

    def play(self, run: FinishedRun, scenario: Scenario, row: Row) -> Take:
        """The step at which an episode was decided, or at which it now goes another way.

        Parameters
        ----------
        run : FinishedRun
        scenario : Scenario
        row : mapping
            Of ``episodes.parquet``, with an action for every step up to the one that decided.
        """
        if not run.end_to_end:
            return self._take(scenario.last_situation(), row[f"step{run.steps[-1]}_action"])
        last = run.steps[-1] if row["failed_step"] is None else row["failed_step"]
        situation = scenario.first_situation()
        while True:
            take = self._take(situation, row[f"step{situation.step}_action"])
            if situation.step == last or not take.outcome.success:
                return take
            situation = scenario.next_situation(situation, take.outcome)

    def _take(self, situation: Situation, action: int) -> Take:
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
        cast = roles(situation)
        world.look = lambda: shots.append(shot_of_world(world, cast))
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


def agreement(row: Row, take: Take) -> str:
    """How an episode that was played again compares with its record.

    Parameters
    ----------
    row : mapping
        Of ``episodes.parquet``.
    take : Take

    Returns
    -------
    {"identical", "same label", "different"}
        ``same label``: the step ended the same way, with other measurements.
    """
    step = take.situation.step
    recorded = row[f"step{step}_success"], row[f"step{step}_failure"]
    label = None if take.outcome.failure is None else take.outcome.failure.value
    if recorded != (take.outcome.success, label):
        return "different"
    same = all(row.get(f"step{step}_{name}", value) == value for name, value in take.outcome.evidence().items())
    return "identical" if same else "same label"
