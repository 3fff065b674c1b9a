"""All hostile policies; and one that does the tries of many, each for one observation."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np

from tests.evaluator.policy.hostile import answering, lasting, reading, taking, talking, weakening
from tests.evaluator.policy.hostile.base import Hostile, answer

MODULES = (reading, talking, lasting, weakening, taking, answering)
POLICIES: dict[str, type[Hostile]] = {
    name: found
    for module in MODULES
    for name, found in vars(module).items()
    if inspect.isclass(found) and issubclass(found, Hostile) and found.__module__ == module.__name__ and found.__doc__
    if found.__subclasses__() == []
}
"""By name."""
TRYING = tuple(name for name, found in POLICIES.items() if found.ends == "denied")
"""Those whose tries are denied."""


def place(name: str) -> str:
    """The reference of a policy, ``file:Class``."""
    return f"{inspect.getfile(POLICIES[name])}:{name}"


ASKING = (
    "ReadsScenarios", "OpensSockets", "InspectsEvaluator", "SignalsEvaluator", "LocksFiles", "WatchesFiles",
    "SetsClock", "RaisesPriority", "PinsItself", "SlowsEvaluator", "SetsFileTimes", "SetsModes", "ReadsOtherProcesses",
)  # fmt: skip
"""Some that leave nothing behind where their tries go through."""


class TriesAll:
    """For the n-th observation, how many tries of the n-th policy of ``names`` succeed."""

    names = TRYING

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        self.policies = [POLICIES[name](checkpoint, device) for name in self.names]

    def act(self, observations: Any) -> np.ndarray:
        return np.concatenate([answer(1, len(one.successes())) for one in self.policies[: len(observations)]])


class TriesSome(TriesAll):
    """Those that may go through."""

    names = ASKING
