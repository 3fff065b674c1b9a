"""The default engine: supervised worker processes that may crash, hang or leak without harming the run."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from multiprocessing.connection import wait

import psutil

from evaluator.engines.base import SIMULATOR, BatchResult, InfraError, Job, JobBatch, JobResult, default_workers
from evaluator.engines.child import Child
from evaluator.engines.worker import DONE, RAISED, READY
from rema_data import interrupts
from rema_data.errors import InfrastructureError
from rema_data.schema import StepOutcome

__all__ = ["ProcessEngine"]

ATTEMPTS = 2
"""An episode that costs this many workers is given up."""
_LOW_WATER = 15
"""A worker is given its next batch when this many jobs are left, so that it never waits for its parent."""
_PAUSE_S = 0.05
"""At most, between two looks at workers that all have more than that to do: every result would wake this process, which
takes a core from a worker for longer than it needs to read the result."""
_START_S = 120.0
"""A worker may be silent for so long while it starts, however little an episode may take."""
_FAILED_STARTS = 3
"""After so many workers in a row that died before they were ready, no more are started."""


class _Worker(Child):
    """A child and the jobs it was given, in the order in which it runs them."""

    def __init__(self, name: str, factory: str) -> None:
        super().__init__("serve", factory)
        self.name = name
        self.jobs: deque[Job] = deque()
        self.ready = self.alone = self.retiring = False
        self.served = self.start_bytes = 0
        self.raised = ""
        self.heard = time.monotonic()

    def give(self, batch: JobBatch, alone: bool) -> None:
        if not self.jobs:
            self.heard = time.monotonic()
        self.jobs.extend(batch)
        self.alone = alone
        with suppress(OSError):  # a worker that died a moment ago: the supervisor is about to read its end
            self.channel.send(batch)

    def resident_bytes(self) -> int:
        try:
            return int(psutil.Process(self.process.pid).memory_info().rss)
        except psutil.Error:
            return 0


class ProcessEngine:
    """Runs batches in worker processes, one simulator each; by default on every core that this process may use.

    A worker that is silent for ``episode_limit_s`` within one episode is killed; while it starts, for two minutes if
    that is more. One whose resident memory grew by more than ``growth_limit_bytes`` is replaced between batches.

    A dead worker's unfinished jobs go to others. The job it died in is tried again, first and alone in a fresh worker;
    if that dies too, the job's result is an ``InfraError`` and the run goes on. The cost beside the simulator is one
    message per job, some tens of microseconds. Batches should stay below about 200 jobs, so that handing one over never
    waits for the worker.
    """

    place = "machine"

    def __init__(
        self,
        factory: str = SIMULATOR,
        workers: int | None = None,
        *,
        address: str | None = None,
        episode_limit_s: float = 120.0,
        growth_limit_bytes: int = 200 * 2**20,
    ) -> None:
        self.workers = default_workers() if workers is None else workers
        self.replaced = 0
        self._factory = factory
        self._limit_s = episode_limit_s
        self._growth = growth_limit_bytes
        self._seats: dict[str, _Worker] = {}
        self._deaths: dict[int, int] = {}
        self._suspects: deque[Job] = deque()
        self._returned: deque[JobBatch] = deque()
        self._failed_starts = 0
        self._job_s = 0.0  # time of a job, of late

    def map(self, batches: Iterable[JobBatch]) -> Iterator[BatchResult]:
        """Run the batches; see ``Engine.map``. Raises InfrastructureError where no worker can be started."""
        source = iter(batches)
        self._deaths.clear()
        self._suspects.clear()
        self._returned.clear()
        try:
            while self._dispatch(source):
                results = self._collect()
                if results:
                    yield tuple(results)
        except BaseException:  # Ctrl-C and an abandoned iterator included: nothing needs what still runs
            self.close(grace_s=0.0)
            raise

    def close(self, grace_s: float = 1.0) -> None:
        """Stop the workers; those that are idle have ``grace_s`` to leave."""
        for worker in self._seats.values():
            worker.channel.close()  # all leave at the same time
        for worker in self._seats.values():
            worker.stop(0.0 if worker.jobs else grace_s)
        self._seats.clear()

    def _dispatch(self, source: Iterator[JobBatch]) -> bool:
        """Fill the seats and give work to who has little; whether anything is under way."""
        for name in [f"w{seat}" for seat in range(self.workers)]:
            worker = self._seats.get(name)
            if worker is not None and (worker.retiring or worker.alone or len(worker.jobs) >= _LOW_WATER):
                continue
            # A suspect runs first and alone, in a worker that has done nothing else.
            alone = bool(self._suspects) and (worker is None or not (worker.served or worker.jobs))
            batch: JobBatch | None
            if alone:
                batch = (self._suspects.popleft(),)
            else:
                batch = self._returned.popleft() if self._returned else next(source, None)
            if batch:
                if worker is None:
                    worker = self._seats[name] = _Worker(name, self._factory)
                worker.give(batch, alone)
        if self._suspects and not any(worker.jobs for worker in self._seats.values()):
            self._remove(next(iter(self._seats.values())), grace_s=1.0)  # idle and used: make room for a fresh one
            return self._dispatch(source)
        return any(worker.jobs for worker in self._seats.values())

    def _remove(self, worker: _Worker, grace_s: float = 0.0) -> str:
        del self._seats[worker.name]
        self.replaced += 1
        return worker.stop(grace_s)

    def _collect(self) -> list[JobResult]:
        """Wait for messages, deaths or a deadline; results of everything that can be read at once."""
        results: list[JobResult] = []
        spare = min(len(worker.jobs) for worker in self._seats.values()) - _LOW_WATER
        if spare > 0:
            time.sleep(min(_PAUSE_S, spare * self._job_s))
        busy = [worker for worker in self._seats.values() if worker.jobs]
        deadline = min(worker.heard + self._silence_s(worker) for worker in busy)
        by_channel = {worker.channel: worker for worker in self._seats.values()}
        interrupts.check()
        for channel in wait(list(by_channel), min(interrupts.POLL_S, max(0.0, deadline - time.monotonic()))):
            self._read(by_channel[channel], results)  # type: ignore[index]
        now = time.monotonic()
        for worker in list(self._seats.values()):
            if worker.jobs and now - worker.heard > (limit_s := self._silence_s(worker)):
                self._lose(worker, results, "hung", f"no sign of life for {limit_s:g} s")
            elif not worker.jobs and worker.retiring:
                self._remove(worker, grace_s=1.0)
        if results:
            self._job_s = sum(result.seconds for result in results) / len(results)
        return results

    def _silence_s(self, worker: _Worker) -> float:
        return self._limit_s if worker.ready else max(self._limit_s, _START_S)

    def _read(self, worker: _Worker, results: list[JobResult]) -> None:
        try:
            while worker.channel.poll(0):
                kind, *content = worker.channel.recv()
                worker.heard = time.monotonic()
                if kind == DONE:
                    results.append(self._finish(worker, *content))
                elif kind == READY:
                    worker.ready = True
                    worker.start_bytes = worker.resident_bytes()
                    self._failed_starts = 0
                elif kind == RAISED:
                    (worker.raised,) = content
        except (EOFError, OSError):
            self._lose(worker, results, "raised" if worker.raised else "died", worker.raised)

    def _finish(self, worker: _Worker, key: int, outcome: StepOutcome, seconds: float) -> JobResult:
        worker.jobs.popleft()
        worker.served += 1
        if worker.alone or len(worker.jobs) in (0, _LOW_WATER):
            worker.alone = False
            worker.retiring |= worker.resident_bytes() - worker.start_bytes > self._growth
        return JobResult(key, outcome, seconds, worker.name, self._deaths.get(key, 0) + 1)

    def _lose(self, worker: _Worker, results: list[JobResult], reason: str, detail: str) -> None:
        """Remove a dead or hung worker, hand its jobs on, and decide about the one it died in."""
        seconds = time.monotonic() - worker.heard
        end = self._remove(worker)
        detail = detail or end
        if not worker.ready:
            self._failed_starts += 1
            if self._failed_starts >= _FAILED_STARTS:
                raise InfrastructureError(
                    f"simulation workers do not start: {detail.strip().splitlines()[-1]}",
                    hint="run the same command with --engine inline to see the whole error",
                    detail=detail,
                )
            if worker.alone:
                self._suspects.extend(worker.jobs)
                worker.jobs.clear()
        elif worker.jobs:
            job = worker.jobs.popleft()
            deaths = self._deaths[job.key] = self._deaths.get(job.key, 0) + 1
            if deaths >= ATTEMPTS:
                results.append(JobResult(job.key, InfraError(reason, detail), seconds, worker.name, deaths))
            else:
                self._suspects.append(job)
        if worker.jobs:
            self._returned.appendleft(tuple(worker.jobs))
