"""Asking, checking and walking on, in a light world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from evaluator.policy import PolicyFault
from evaluator.rollout.ask import actions, ask, attempt
from evaluator.rollout.episode import frozen_scenario, next_step, walk
from evaluator.run.records import POLICY_FAULT
from evaluator.scenarios import ScenarioList
from rema_data import grid
from rema_data.errors import InputError, PolicyFailureError
from rema_data.schema import TASKS, Failure, Scenario, Situation, StepOutcome
from tests.evaluator.fakes import FakePolicyProcess, FakeSimulator, fake_backend, fake_scenario

SITUATIONS = [fake_scenario("grasp_push", index).last_situation() for index in range(5)]


@dataclass
class Done:
    situation: Situation
    outcome: StepOutcome


def steps(scenario: Scenario, protocol: str, fails_at: int | None = None) -> list[int]:
    def one(situation: Situation) -> Done:
        failed = situation.step == fails_at
        return Done(situation, StepOutcome(not failed, Failure.MISSED if failed else None))

    return [done.situation.step for done in walk(scenario, protocol, one)]


@pytest.mark.parametrize("task", TASKS)
def test_an_episode_ends_with_its_last_or_its_first_failed_step(task: str) -> None:
    scenario, last = fake_scenario(task, 3), len(TASKS[task]) - 1
    assert steps(scenario, "conditional") == [last]
    assert steps(scenario, "end-to-end") == list(range(last + 1))
    assert steps(scenario, "end-to-end", fails_at=0) == [0]
    assert next_step(scenario, scenario.last_situation(), StepOutcome(True, None)) is None


def test_only_a_privileged_policy_is_shown_the_situations() -> None:
    seen: list[Any] = []

    class Process(FakePolicyProcess):
        def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> list[Any]:
            seen.append(situations)
            return super().act(batch, None)

    process = Process()
    first = ask(process, fake_backend(), SITUATIONS)
    process.privileged = True
    assert ask(process, fake_backend(), SITUATIONS) == first and len(first) == len(SITUATIONS)
    assert seen == [None, tuple(SITUATIONS)]


def test_the_first_fault_is_raised_with_its_position() -> None:
    def error(position: int, fault: PolicyFault) -> PolicyFailureError:
        return PolicyFailureError(f"{position}: {fault.reason}", hint="fix it")

    assert actions([4, 5], error) == [4, 5]
    with pytest.raises(PolicyFailureError, match="1: timeout"):
        actions([4, PolicyFault("timeout", ""), PolicyFault("died", "")], error)


def test_an_action_that_is_not_valid_is_not_simulated() -> None:
    def never(situation: Situation, action: int) -> StepOutcome:
        raise AssertionError("simulated")

    backend, inside = fake_backend(), int(grid.encode(32, 32, 0))
    for action in (0, -1, grid.ACTIONS):
        assert attempt(never, backend, SITUATIONS[0], action) is POLICY_FAULT
    simulator = FakeSimulator()
    assert attempt(simulator.run, backend, SITUATIONS[0], inside) == simulator.run(SITUATIONS[0], inside)


def test_a_scenario_without_tools_has_no_last_step() -> None:
    bare = Scenario("grasp_push", "test", 0, fake_scenario("grasp_push", 0).placements)
    frozen = ScenarioList("grasp_push", "test", "v1", "", (bare,))
    assert frozen_scenario(frozen, 0, "end-to-end") is bare
    with pytest.raises(InputError, match="could not pick up the tools of scenario 0"):
        frozen_scenario(frozen, 0, "conditional")
    with pytest.raises(InputError, match="no scenario 1 in the test list of grasp_push"):
        frozen_scenario(frozen, 1, "end-to-end")
