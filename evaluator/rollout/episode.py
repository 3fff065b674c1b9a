"""An episode, step by step: where a protocol begins, and which situation follows an outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol, TypeVar

from evaluator.run.plan import Plan
from evaluator.scenarios import ScenarioList
from rema_data.errors import InputError
from rema_data.schema import Scenario, Situation, StepOutcome

__all__ = ["first_step", "frozen_scenario", "next_step", "walk"]


class _Attempt(Protocol):
    @property
    def outcome(self) -> StepOutcome: ...


_T = TypeVar("_T", bound=_Attempt)


def first_step(scenario: Scenario, protocol: str) -> Situation:
    """The first situation in which a policy acts: the last step (conditional), or the first one (end-to-end)."""
    return scenario.first_situation() if protocol == "end-to-end" else scenario.last_situation()


def next_step(scenario: Scenario, done: Situation, outcome: StepOutcome) -> Situation | None:
    """The situation after ``done``, or None where its outcome ended the episode."""
    return scenario.next_situation(done, outcome) if outcome.success and not done.last else None


def walk(scenario: Scenario, protocol: str, attempt: Callable[[Situation], _T]) -> Iterator[_T]:
    """Attempt one step after another until the episode ends; yields what ``attempt`` returns for each step."""
    situation: Situation | None = first_step(scenario, protocol)
    while situation is not None:
        done = attempt(situation)
        yield done
        situation = next_step(scenario, situation, done.outcome)


def frozen_scenario(frozen: ScenarioList, index: int, protocol: str) -> Scenario:
    """A scenario of a frozen list that ``protocol`` can be played on.

    Raises InputError beyond the list, or where the conditional protocol needs tools in hand and there are none.
    """
    scenarios, task = frozen.scenarios, frozen.task
    if not 0 <= index < len(scenarios):
        raise InputError(
            f"there is no scenario {index} in the {frozen.split} list of {task}",
            hint=f"choose one from 0 to {len(scenarios) - 1}",
            index=index,
        )
    if not Plan((), task, protocol).eligible(scenarios[index]):
        raise InputError(
            f"the reference policy could not pick up the tools of scenario {index}, so its last step has no start",
            hint="choose another scenario, or the protocol end-to-end",
            index=index,
        )
    return scenarios[index]
