"""Which steps a policy acts in, which episodes are alive there, and in which order they are simulated."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from evaluator.engines import Job, JobBatch
from evaluator.protocol import acting_steps
from evaluator.run.records import Records
from evaluator.scenarios import ScenarioList, installed_list, load_list, versions
from rema_data.errors import RunMismatchError
from rema_data.schema import Scenario, Situation, StepOutcome, pinch_step, tool_steps

__all__ = ["Plan", "arrange", "find_list", "job_batches", "scenario_list"]

BATCH_JOBS = 25
_ORDER_KEY = b"rema simulation order v1"
_T = TypeVar("_T")


class Plan:
    """The episodes of a run and ``steps``, those in which its policy acts: the last one (conditional), or all."""

    def __init__(self, scenarios: Sequence[Scenario], task: str, protocol: str) -> None:
        self.scenarios = scenarios
        self.task = task
        self.end_to_end = protocol == "end-to-end"
        self.steps = acting_steps(task, protocol)

    def eligible(self, scenario: Scenario) -> bool:
        """Whether the protocol can be run on ``scenario``: the conditional one needs its tools in hand."""
        if self.end_to_end:
            return True
        has_pinch = scenario.pinch is not None
        return len(scenario.grips) == len(tool_steps(self.task)) and has_pinch == (pinch_step(self.task) is not None)

    def alive(self, step: int, records: Records) -> dict[int, Situation]:
        """Situation of every episode that reaches ``step``, by scenario index, in ascending order."""
        if not self.end_to_end:
            return {scenario.index: scenario.last_situation() for scenario in self.scenarios if self.eligible(scenario)}
        situations: dict[int, Situation] = {}
        for scenario in self.scenarios:
            situation: Situation | None = scenario.first_situation()
            for earlier in range(step):
                result = records.result(scenario.index, earlier)
                if situation is None or not isinstance(result, StepOutcome) or not result.success:
                    situation = None
                    break
                situation = scenario.next_situation(situation, result)
            if situation is not None:
                situations[scenario.index] = situation
        return situations


def scenario_list(header: Mapping[str, Any]) -> ScenarioList:
    """The list on which a run was played, of whichever version; a RunMismatchError if it is not here."""
    identity = header["identity"]
    return find_list(identity["task"], identity["split"], identity["scenarios_hash"], header["episodes"])


def find_list(task: str, split: str, sha256: str, episodes: int) -> ScenarioList:
    """The list with this hash, of whichever version; a RunMismatchError where it is not here, or is shorter."""
    here = []
    for version in versions():
        listed = installed_list(task, split, version)
        if listed is None:
            continue
        if listed[0] == sha256 and episodes <= listed[1]:
            return load_list(task, split, version)
        here.append(listed[0])
    raise RunMismatchError(
        f"the run was played on another scenario list than the ones here: {sha256}, here {', '.join(here) or 'none'}",
        hint="use the version of rema that made it (`versions` in run.json)",
        field="scenarios_hash",
        recorded=sha256,
        here=here,
    )


def arrange(items: Sequence[_T], order: str, keys: Sequence[int]) -> list[_T]:
    """``items`` forward, reversed, or shuffled by a fixed hash of their ``keys``."""
    if order == "shuffled":
        ranks = [hashlib.blake2b(key.to_bytes(8, "big"), digest_size=16, key=_ORDER_KEY).digest() for key in keys]
        return [item for _, item in sorted(zip(ranks, items, strict=True), key=lambda pair: pair[0])]
    return list(items) if order == "forward" else list(reversed(items))


def job_batches(jobs: Sequence[Job]) -> Iterator[JobBatch]:
    """Jobs in groups of 25: seconds of work, little to lose."""
    for start in range(0, len(jobs), BATCH_JOBS):
        yield tuple(jobs[start : start + BATCH_JOBS])
