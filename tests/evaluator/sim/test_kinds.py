"""Every kind of step answers all questions, and outcomes carry what was measured."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest

from evaluator.sim.fingerprint import fingerprint
from evaluator.sim.kinds import KINDS, Kind
from evaluator.sim.parameters import WORLD
from evaluator.sim.simulator import Simulator
from rema_data import grid
from rema_data.schema import EVIDENCE, TASKS, Placement, Situation, StepOutcome
from tests.evaluator.sim.conftest import STICK, TEE, held


def test_every_step_of_every_task_has_its_kind() -> None:
    assert {step for steps in TASKS.values() for step in steps} == set(KINDS)


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: type(kind).__name__)
def test_a_kind_agrees_with_the_schema(kind: Kind) -> None:
    assert KINDS[kind.step] is kind
    assert kind.measure in EVIDENCE
    assert kind.criterion().startswith(kind.goal(WORLD))
    assert kind.bare == (kind.role is None)
    assert kind.bare or kind.touching in kind.criterion()
    assert kind.two_arms == (kind.turns[0] != kind.turns[1])
    assert (kind.reach_shifts(WORLD)[-1] > 0) == (kind.measure == "displacement_m")
    x, y = kind.spawn(np.random.default_rng(0), WORLD)
    assert max(abs(x), abs(y)) < grid.SCENE_HALF_M
    target, valid = Placement(TEE, 0.01, 0.02, 0.3), np.ones(grid.ACTIONS, bool)
    candidates = list(kind.candidates(target, valid, np.random.default_rng(0), WORLD))
    assert bool(candidates) == (kind.step.makes is not None)


def test_one_hand_with_a_tool_in_the_other_picks_with_open_empty_fingers() -> None:
    """The second pick of a task: what the first hand holds does not take part."""
    pick = KINDS[TASKS["grasp_grasp"][1]]
    situation = Situation("grasp_grasp", 1, Placement(TEE, 0.0, 0.0, 0.0), (held(STICK),))
    (hand,) = pick.hands(situation, (0.0, 0.0, 0.0), 0.1, "right")
    assert (hand.arm, hand.opening_m) == ("right", WORLD.opening_max_m)
    assert pick.held(situation, [hand], (0.0, 0.0, 0.0)) == []


@dataclass(frozen=True, slots=True, kw_only=True)
class RicherOutcome(StepOutcome):
    """An outcome of a later version, which measures one thing more."""

    heat_j: float = 0.0


def test_a_field_that_outcomes_gain_does_not_change_the_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    before, run = fingerprint(), Simulator.run

    def richer(simulator: Simulator, situation: Situation, action: int) -> StepOutcome:
        outcome = run(simulator, situation, action)
        return RicherOutcome(**{item.name: getattr(outcome, item.name) for item in fields(outcome)})

    monkeypatch.setattr(Simulator, "run", richer)
    assert fingerprint() == before
