"""Filmed episodes: the same outcomes as without a camera, step by step, and what the pictures show."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from evaluator.render.film import FilmMaker, Take, agreement
from evaluator.sim.simulator import Simulator
from rema_data import grid
from rema_data.schema import Failure, ObjectSpec, Placement, Scenario, Shape, Situation, StepOutcome
from rema_data.variation import Variation

STICK = ObjectSpec(Shape.I, 0.11, 0.025, 0.0, 0.03)
ELL = ObjectSpec(Shape.L, 0.11, 0.03, 0.09, 0.03)
SCENARIO = Scenario("grasp_push", "test", 0, (Placement(STICK, 0.0, 0.02, 0.3), Placement(ELL, 0.02, 0.0, 1.0)))


@pytest.fixture(scope="module")
def films() -> Iterator[FilmMaker]:
    with FilmMaker() as maker:
        yield maker


@pytest.fixture(scope="module")
def simulator() -> Iterator[Simulator]:
    found = Simulator()
    yield found
    found.close()


def played_again(films: FilmMaker, row: dict[str, Any]) -> Take:
    return films.play(SCENARIO, "end-to-end", lambda situation: row[f"step{situation.step}_action"], row["failed_step"])


def recorded(outcomes: list[tuple[int, StepOutcome]]) -> dict[str, Any]:
    """The row of an episode."""
    row: dict[str, Any] = {"failed_step": None}
    for step, (action, outcome) in enumerate(outcomes):
        row |= {f"step{step}_action": action, f"step{step}_success": outcome.success}
        row[f"step{step}_failure"] = None if outcome.failure is None else outcome.failure.value
        row |= {f"step{step}_{name}": value for name, value in outcome.evidence().items()}
        if not outcome.success:
            row["failed_step"] = step
    return row


@pytest.fixture(scope="module")
def picked(simulator: Simulator) -> tuple[int, StepOutcome]:
    """An action that picks the tool up."""
    target = SCENARIO.placements[0]
    for k in range(grid.ANGLES):
        action = int(grid.snap(target.x_m, target.y_m, k * 2 * np.pi / grid.ANGLES))
        outcome = simulator.run(SCENARIO.first_situation(), action)
        if outcome.success:
            return action, outcome
    raise AssertionError("no angle picks the tool up")


def test_an_end_to_end_episode_is_played_up_to_its_last_step(
    films: FilmMaker, simulator: Simulator, picked: tuple[int, StepOutcome]
) -> None:
    situation = SCENARIO.next_situation(SCENARIO.first_situation(), picked[1])
    pushes = [int(grid.snap(x, 0.0, k * np.pi / 8)) for x in (-0.1, -0.06) for k in range(grid.ANGLES)]
    push = next(action for action in pushes if simulator.run(situation, action).success)
    row = recorded([picked, (push, simulator.run(situation, push))])
    take = played_again(films, row)
    assert take.situation == situation and take.action == push
    assert agreement(row, take) == "identical" and take.outcome.success
    assert len(take.shots) > 10
    assert {body.role for body in take.shots[0].bodies} == {"target", "tool"}
    start, end = take.shots[0].bodies[0].position[0], take.shots[-1].bodies[0].position[0]
    assert end - start == pytest.approx(take.outcome.displacement_m, abs=2e-3)


def test_an_episode_stops_where_it_differs(films: FilmMaker, picked: tuple[int, StepOutcome]) -> None:
    beside = int(grid.encode(50, 50, 0))
    row = recorded([(beside, picked[1]), (beside, StepOutcome(True, None))])
    take = played_again(films, row)
    assert take.situation.step == 0 and take.outcome.failure is Failure.MISSED
    assert agreement(row, take) == "different"
    assert take.shots  # a miss needs no simulation, but is shown, too


def test_where_no_arm_can_move_there_is_only_a_before(films: FilmMaker) -> None:
    row = recorded([(0, StepOutcome(False, Failure.UNREACHABLE))])
    take = played_again(films, row)
    assert take.outcome.failure is Failure.UNREACHABLE and not take.shots
    assert take.before.bodies


def test_other_digits_and_another_label_are_distinguished(picked: tuple[int, StepOutcome]) -> None:
    action, outcome = picked
    row = recorded([(action, outcome)])
    situation = Situation("grasp_push", 0, SCENARIO.placements[0])

    def take(**changes: Any) -> Take:
        return Take(situation, action, dataclasses.replace(outcome, **changes), None, ())  # type: ignore[arg-type]

    assert agreement(row, take()) == "identical"
    assert agreement(row, take(lift_m=outcome.lift_m + 1e-12)) == "same label"
    assert agreement(row, take(success=False, failure=Failure.SLIPPED)) == "different"


def test_what_stands_beside_the_target_is_shown(films: FilmMaker, simulator: Simulator) -> None:
    """The object between the fingers is the target of the attempt, wherever the episode's own target lies."""
    other, own = Placement(STICK, 0.07, -0.06, 0.0), Placement(ELL, -0.05, 0.05, 1.0)
    variation = Variation("clutter", 1, 0, others=(other,))
    situation = Scenario("grasp", "train", 0, (own,), variation=variation).first_situation()
    action = int(grid.snap(other.x_m, other.y_m, np.pi / 2))
    take = films.take(situation, action)
    assert take.outcome == simulator.run(situation, action)
    assert [(body.role, body.spec) for body in take.before.bodies] == [("target", ELL), ("other", STICK)]
    start = take.shots[0].bodies
    assert [(body.role, body.spec) for body in start] == [("target", STICK), ("other", ELL)]
    assert start[1].position[:2] == pytest.approx((own.x_m, own.y_m), abs=1e-3)


def test_an_object_is_shown_where_its_shape_is(films: FilmMaker) -> None:
    """Not where its centre of mass is, if that lies elsewhere."""
    own = Placement(ELL, 0.0, 0.02, 1.0)
    variation = Variation("physics", 1, 0, mass_offset_m=(0.02, 0.01))
    situation = Scenario("push", "train", 0, (own,), variation=variation).first_situation()
    take = films.take(situation, int(grid.snap(-0.06, 0.02, 0.0)))
    assert take.shots[0].bodies[0].position[:2] == pytest.approx((own.x_m, own.y_m), abs=1e-3)
