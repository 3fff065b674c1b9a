"""The reference engine: one loop in this process, for debuggers and for comparison with the others."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterable, Iterator

from evaluator.engines.base import (
    SIMULATOR,
    BatchResult,
    InfraError,
    Job,
    JobBatch,
    JobResult,
    StepSimulator,
    load_attribute,
)
from rema_data.interrupts import check
from rema_data.schema import StepOutcome

__all__ = ["InlineEngine"]


class InlineEngine:
    """Runs every job here, one after the other; ``workers`` and ``address`` change nothing.

    A simulator that kills its process kills this one; ``ProcessEngine`` survives that.
    """

    place = "here"
    workers = 1

    def __init__(self, factory: str = SIMULATOR, workers: int | None = None, *, address: str | None = None) -> None:
        self._factory = factory
        self._simulator: StepSimulator | None = None

    def map(self, batches: Iterable[JobBatch]) -> Iterator[BatchResult]:
        """Run the jobs in the order given; see ``Engine.map``."""
        for batch in batches:
            for job in batch:
                check()
                yield (self._run(job),)

    def _run(self, job: Job) -> JobResult:
        """One job, tried a second time in a fresh simulator where the first raised."""
        for attempt in (1, 2):  # noqa: B007 - part of the result
            if self._simulator is None:
                self._simulator = load_attribute(self._factory)()
            start = time.perf_counter()
            outcome: StepOutcome | InfraError
            try:
                outcome = self._simulator.run(job.situation, job.action)
            except Exception:
                outcome = InfraError("raised", traceback.format_exc(limit=-5))
                self.close()
            if isinstance(outcome, StepOutcome):
                break
        return JobResult(job.key, outcome, time.perf_counter() - start, "inline", attempt)

    def close(self) -> None:
        """Close the simulator."""
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None
