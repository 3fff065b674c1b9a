"""Questions of every step of a task, from its validation list: what a policy is asked before it is evaluated."""

from __future__ import annotations

from dataclasses import dataclass

from evaluator.policy.contract import ObservationBatch
from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.schema import TASKS, Scenario, Situation

__all__ = ["Questions", "questions"]


@dataclass(frozen=True, slots=True, eq=False)
class Questions:
    """Observations of one step of one task, and the situations behind them."""

    batch: ObservationBatch
    situations: tuple[Situation, ...]

    def part(self, numbers: slice) -> Questions:
        """Some of them, in the order of ``numbers``."""
        return Questions(self.batch.part(numbers), self.situations[numbers])


def questions(task: str, count: int) -> list[Questions]:
    """The first ``count`` validation scenarios of a task at each of its steps, with the scenarios' tools in hand.

    The last step is what the conditional protocol asks, all of them what the end-to-end protocol asks.
    """
    scenarios = load_list(task, "val").scenarios[:count]
    found = []
    for step in range(len(TASKS[task])):
        situations = tuple(_situation(scenario, step) for scenario in scenarios)
        observations = [observe(situation) for situation in situations]
        found.append(Questions(ObservationBatch.of(situations[0], observations, valid_actions(task, step)), situations))
    return found


def _situation(scenario: Scenario, step: int) -> Situation:
    if step == len(scenario.placements) - 1:
        return scenario.last_situation()
    return Situation(scenario.task, step, scenario.placements[step], scenario.grips[:step])
