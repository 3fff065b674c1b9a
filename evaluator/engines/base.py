"""What crosses the border of an engine: jobs in, results out, and nothing of the engine's own kind.

This module is imported by every simulation worker: only the records of ``rema_data`` may be imported here.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from rema_data.errors import InputError
from rema_data.schema import Situation, StepOutcome

__all__ = [
    "FINGERPRINT",
    "SIMULATOR",
    "Engine",
    "InfraError",
    "Job",
    "JobResult",
    "Shard",
    "ShardResult",
    "StepSimulator",
    "default_workers",
    "load_attribute",
]

SIMULATOR = "evaluator.sim.simulator:Simulator"
"""The factory that workers call, as ``module:attribute``: a name crosses process borders, an object does not."""
FINGERPRINT = "evaluator.sim.fingerprint:fingerprint"
"""What tells the simulators of different machines apart, likewise."""


class StepSimulator(Protocol):
    """What a factory returns: a pure function of (situation, action) that owns resources."""

    def run(self, situation: Situation, action: int) -> StepOutcome:
        """Outcome of one action."""
        ...

    def close(self) -> None:
        """Release what it holds."""
        ...


@dataclass(frozen=True, slots=True)
class Job:
    """One action to simulate.

    Attributes
    ----------
    key : int
        Chosen by the caller, unique within one ``map``.
    situation : Situation
    action : int
        Grid index.
    """

    key: int
    situation: Situation
    action: int


Shard = tuple[Job, ...]
"""The unit of dispatch: more than a moment's work, little to lose."""


@dataclass(frozen=True, slots=True)
class InfraError:
    """Why there is no outcome: ``reason`` is one word (``died``, ``hung``, ``raised``), ``detail`` for people."""

    reason: str
    detail: str


@dataclass(frozen=True, slots=True)
class JobResult:
    """What came of one job.

    Attributes
    ----------
    key : int
        Of the job.
    outcome : StepOutcome or InfraError
    seconds : float
        Wall time inside the simulator.
    worker : str
        Which worker ran it.
    attempt : int
        1 unless it lost a worker before.
    """

    key: int
    outcome: StepOutcome | InfraError
    seconds: float
    worker: str
    attempt: int = 1


ShardResult = tuple[JobResult, ...]
"""Results in the order in which they finished. A shard may come back in several parts, so that a kill loses little."""


class Engine(Protocol):
    """Maps shards to results, unordered, as they finish."""

    def map(self, shards: Iterable[Shard]) -> Iterator[ShardResult]:
        """Run every job once and yield every key exactly once, in groups.

        An empty shard means: nothing at present, ask again after the next results.
        """
        ...

    def close(self) -> None:
        """Stop whatever runs. An engine can be used again afterwards."""
        ...


def load_attribute(target: str) -> Callable[[], Any]:
    """The callable that ``module:attribute`` names.

    Raises
    ------
    InputError
        It is not of that form, or there is no such attribute.
    """
    module, _, attribute = target.partition(":")
    if not module or not attribute:
        raise InputError(f"{target!r} does not name a callable", hint="write it as module:attribute", target=target)
    found = getattr(importlib.import_module(module), attribute, None)
    if not callable(found):
        raise InputError(f"module {module} has no callable {attribute!r}", hint="check the name", target=target)
    return found  # type: ignore[no-any-return]


def default_workers() -> int:
    """Number of cores that this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)
