"""What crosses the border of an engine: jobs in, results out, and nothing of the engine's own kind.

This module is imported by every simulation worker: only the records of ``rema_data`` may be imported here.
"""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from rema_data.errors import InputError
from rema_data.schema import Situation, StepOutcome

__all__ = [
    "FINGERPRINT",
    "SIMULATOR",
    "BatchResult",
    "Engine",
    "EngineType",
    "InfraError",
    "Job",
    "JobBatch",
    "JobResult",
    "StepSimulator",
    "default_workers",
    "load_attribute",
    "signal_name",
]

SIMULATOR = "evaluator.sim.simulator:Simulator"
"""The factory that workers call, as ``module:attribute``: a name crosses process borders, an object does not."""
FINGERPRINT = "evaluator.sim.fingerprint:fingerprint"
"""What two simulators with the same outcomes have in common, likewise."""


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
    """One action to simulate."""

    key: int  # chosen by the caller, unique within one ``map``
    situation: Situation
    action: int  # grid index


JobBatch = tuple[Job, ...]
"""The unit of dispatch: large enough to be worth a message, small enough to be lost."""


@dataclass(frozen=True, slots=True)
class InfraError:
    """Why there is no outcome: ``reason`` is one word (``died``, ``hung``, ``raised``), ``detail`` for people."""

    reason: str
    detail: str


@dataclass(frozen=True, slots=True)
class JobResult:
    """The result of one job."""

    key: int  # of the job
    outcome: StepOutcome | InfraError
    seconds: float  # wall time inside the simulator
    worker: str  # which worker ran it
    attempt: int = 1  # 1 unless it lost a worker before


BatchResult = tuple[JobResult, ...]
"""Results in the order in which they finished. A batch may come back in several parts, so that a kill loses little."""


class Engine(Protocol):
    """Maps batches of jobs to results, unordered, as they finish. ``evaluator.testing.engines`` tests what it keeps.

    An engine of your own is a class that takes what ``EngineType`` says. Declare it as an entry point of the group
    ``rema.engines``; ``--engine NAME`` then finds it.
    """

    @property
    def workers(self) -> int:
        """How many simulators run at a time. An engine may connect to its cluster to find out."""
        ...

    def map(self, batches: Iterable[JobBatch]) -> Iterator[BatchResult]:
        """Run every job once and yield every key exactly once, in groups.

        An empty batch means: nothing at present, ask again after the next results.
        """
        ...

    def close(self) -> None:
        """Stop everything that runs. An engine can be used again afterwards."""
        ...


class EngineType(Protocol):
    """The class of an engine. Making one starts nothing; a library that is missing is an ``InputError``.

    Attributes
    ----------
    place : {"here", "machine", "cluster"}
        Where simulators run: in the calling process, in other processes of this machine, or on other machines. Only
        the last kind is given an address.
    """

    place: ClassVar[str]

    def __call__(self, factory: str, workers: int | None, *, address: str | None) -> Engine:
        """An engine.

        Parameters
        ----------
        factory : str
            ``module:attribute`` of a callable that returns a ``StepSimulator``; an object would not cross processes.
        workers : int or None
            Simulators at a time, positive; None for as many as the engine has room for.
        address : str or None
            Of the cluster.
        """
        ...


def load_attribute(target: str) -> Callable[[], Any]:
    """The callable that ``module:attribute`` names. Raises InputError where there is none."""
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


def signal_name(number: int) -> str:
    """Name of a signal: ``SIGKILL``, or ``SIGRTMIN+6`` for one of the many that Python has no name for."""
    try:
        return signal.Signals(number).name
    except ValueError:
        first = getattr(signal, "SIGRTMIN", None)
        return f"signal {number}" if first is None or number < first else f"SIGRTMIN+{number - first}"
