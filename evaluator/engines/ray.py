"""Many machines: the batches of a run through an existing Ray cluster, by actors that hold one simulator each.

A simulator that dies is replaced by the process engine in its actor.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any

from evaluator.engines.base import FINGERPRINT, SIMULATOR, BatchResult, InfraError, JobBatch, JobResult
from evaluator.engines.child import call_in_child
from evaluator.engines.process import ATTEMPTS, ProcessEngine
from rema_data.errors import InfrastructureError, InputError, RemaError
from rema_data.interrupts import check

__all__ = ["ADDRESS", "RayEngine"]

ADDRESS = "auto"
"""Address of the cluster by default: what ``RAY_ADDRESS`` says, else the one that this machine is part of."""
_OPTIONS = {"num_cpus": 1, "max_restarts": 0, "max_task_retries": 0, "scheduling_strategy": "SPREAD"}
"""Ray retries nothing: it would run jobs again without a count."""
_DEPTH = 2
"""Batches given to an actor at a time, so that it never waits for the next one."""
_POLL_S = 1.0
_START_S = 600.0
"""How long to wait for an actor while nothing runs: a cluster may have to start a machine first."""
_FAILED_STARTS = 3
"""After so many actors in a row that were lost before they were ready, while no other is, no more are started."""
_RETRY_S = 5.0
_CONNECT_S = 10.0


class RayWorker:
    """An actor: the parent of one simulation process, which may crash, hang or leak. Ray is not imported for it."""

    def __init__(self, factory: str, episode_limit_s: float) -> None:
        self._engine = ProcessEngine(factory, 1, episode_limit_s=episode_limit_s)

    def begin(self, same: str | None) -> Any:
        """Value of the call that ``same`` names, on this machine: the actor is there once this has come back."""
        return None if same is None else call_in_child(same)

    def run(self, batch: JobBatch) -> BatchResult:
        """Results of all jobs of a batch."""
        return tuple(result for part in self._engine.map((batch,)) for result in part)


@dataclasses.dataclass(slots=True, eq=False)
class _Seat:
    """One actor: its pending start (None once it is ready), and its batches in the order in which it runs them."""

    name: str
    actor: Any
    start: Any
    calls: deque[tuple[Any, JobBatch]] = dataclasses.field(default_factory=deque)


class RayEngine:
    """Runs batches on a Ray cluster, whose machines need the same version of this package.

    Every worker takes one CPU. ``address`` is that of ``ray.init``: ``local`` starts a cluster on this machine for as
    long as the engine lives. A process that is connected already stays so. ``same`` (``module:attribute``) is a call
    whose value must be the same on every machine as here; the fingerprint of the simulator by default, so that outcomes
    of another build never enter a run. Raises InputError where Ray is not installed.

    A lost actor is replaced by a new one wherever there is room. The jobs that it was running go out again one by one;
    a job that loses a second actor is given up with an ``InfraError``, as in ``ProcessEngine``. Jobs that only waited
    for the lost actor are not counted.
    """

    place = "cluster"

    def __init__(
        self,
        factory: str = SIMULATOR,
        workers: int | None = None,
        *,
        address: str | None = None,
        same: str | None = None,
        episode_limit_s: float = 120.0,
    ) -> None:
        try:
            self._ray: Any = importlib.import_module("ray")
        except ImportError as error:
            raise InputError(
                "the ray engine needs Ray, which is not installed", hint='pip install "rema[ray]"'
            ) from error
        self.replaced = 0
        self._workers, self._address = workers, address or ADDRESS
        self._worker = factory, episode_limit_s
        self._same = FINGERPRINT if same is None and factory == SIMULATOR else same
        self._expected: Any = None
        self._make_actor: Any = None
        self._ours = False  # whether the connection is to be closed again
        self._seats: list[_Seat] = []
        self._waiting: deque[JobBatch] = deque()
        self._losses: dict[int, int] = {}
        self._failed_starts = self._number = 0
        self._may_start = self._idle_since = 0.0

    @property
    def workers(self) -> int:
        """Number of actors; connects where it was not given. Raises InputError where the address has no cluster."""
        if self._workers is None:
            self._connect()
            self._workers = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        return self._workers

    def map(self, batches: Iterable[JobBatch]) -> Iterator[BatchResult]:
        """Run the batches; see ``Engine.map``.

        Raises InputError where the address has no cluster, InfrastructureError where no actor starts or a machine
        simulates differently.
        """
        self._connect()
        source = iter(batches)
        self._waiting.clear()
        self._losses.clear()
        self._idle_since = time.monotonic()
        try:
            while self._dispatch(source):
                results = self._collect()
                if results:
                    yield tuple(results)
        except BaseException:  # Ctrl-C and an abandoned iterator included: nothing needs what still runs
            self._stop_all()
            raise

    def close(self) -> None:
        """Stop the actors, and leave the cluster if this engine joined it."""
        self._stop_all()
        if self._ours:
            self._ray.shutdown()
            self._ours = False

    def _connect(self) -> None:
        if not self._ray.is_initialized():
            self._join(os.environ.get("RAY_ADDRESS", ADDRESS) if self._address == ADDRESS else self._address)
        if self._make_actor is None:
            self._make_actor = self._ray.remote(**_OPTIONS)(RayWorker)
            self._expected = None if self._same is None else call_in_child(self._same)

    def _join(self, address: str) -> None:
        stop = signal.getsignal(signal.SIGTERM)
        try:
            _check_reachable(address)
            self._ray.init(address=address, log_to_driver=False, logging_level="WARNING")
        except (OSError, ValueError, RuntimeError, self._ray.exceptions.RayError) as error:
            raise InputError(
                f"there is no Ray cluster at {address!r}: {str(error).strip().splitlines()[0]}",
                hint="start one (ray start --head) and name it: --address HOST:PORT; --address local starts one on "
                "this machine for as long as it is needed",
                address=address,
            ) from error
        finally:
            if stop is not None and threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, stop)  # Ray takes it to leave at once
        self._ours = True

    def _stop_all(self) -> None:
        for seat in tuple(self._seats):
            self._stop(seat)

    def _stop(self, seat: _Seat) -> None:
        self._seats.remove(seat)
        with suppress(Exception):  # it may be gone, and so may the cluster
            self._ray.kill(seat.actor)

    def _dispatch(self, source: Iterator[JobBatch]) -> bool:
        """Give work to the actors that have little, start those that there is work for; whether any is under way."""
        # A job that was lost shares no actor with another one: which of the two took it along would be unknown.
        depth = 1 if self._losses else _DEPTH
        for seat in self._seats:
            while seat.start is None and len(seat.calls) < depth:
                batch = self._waiting.popleft() if self._waiting else next(source, None)
                if not batch:
                    break
                seat.calls.append((seat.actor.run.remote(batch), batch))
        starting = sum(seat.start is not None for seat in self._seats)
        while len(self._seats) < self.workers and time.monotonic() >= self._may_start:
            if starting >= len(self._waiting):
                batch = next(source, None)  # one for every actor that is started
                if not batch:
                    break
                self._waiting.append(batch)
            actor = self._make_actor.remote(*self._worker)
            self._seats.append(_Seat(f"r{self._number}", actor, actor.begin.remote(self._same)))
            self._number += 1
            starting += 1
        return bool(self._waiting) or any(seat.calls for seat in self._seats)

    def _collect(self) -> list[JobResult]:
        """Wait for a while for a start, a result or a loss; the results that came with it."""
        check()
        awaited = {}
        for seat in self._seats:
            if seat.start is not None or seat.calls:
                awaited[seat.calls[0][0] if seat.start is None else seat.start] = seat
        if not awaited:
            time.sleep(_POLL_S)
        elif done := self._ray.wait(list(awaited), num_returns=1, timeout=_POLL_S)[0]:
            return self._read(awaited[done[0]], done[0])
        if any(seat.start is None for seat in self._seats):
            self._idle_since = time.monotonic()
        elif time.monotonic() - self._idle_since > _START_S:
            raise InfrastructureError(
                f"no actor could be placed on the Ray cluster within {_START_S:g} s",
                hint="`ray status` shows what its CPUs are used for; ask for fewer with --workers",
            )
        return []

    def _read(self, seat: _Seat, done: Any) -> list[JobResult]:
        """What came back from an actor."""
        errors = self._ray.exceptions
        try:
            value = self._ray.get(done)
        except errors.RayTaskError as error:
            raise _cannot_simulate(error.cause) from error
        except errors.RayError as error:
            if getattr(error, "actor_init_failed", False):
                raise _cannot_simulate(error) from error
            return self._lose(seat, str(error))
        self._idle_since = time.monotonic()
        if seat.start is None:
            seat.calls.popleft()
            return [
                dataclasses.replace(one, worker=seat.name, attempt=one.attempt + self._losses.get(one.key, 0))
                for one in value
            ]
        if value != self._expected:
            raise InfrastructureError(
                f"a machine of the Ray cluster simulates differently from this one: {self._same} is {value} there "
                f"and {self._expected} here",
                hint="install the same versions on machines of one kind, or evaluate one part on each kind (--shard)",
                expected=self._expected,
                got=value,
            )
        seat.start, self._failed_starts = None, 0
        return []

    def _lose(self, seat: _Seat, detail: str) -> list[JobResult]:
        """Hand the batches of a lost actor on, and give up the jobs that lost one before."""
        self._stop(seat)
        self.replaced += 1
        if seat.start is not None:
            self._failed_starts += 1
            self._may_start = time.monotonic() + _RETRY_S
            if self._failed_starts >= _FAILED_STARTS and all(other.start is not None for other in self._seats):
                raise InfrastructureError(
                    f"actors do not start on the Ray cluster: {detail.strip().splitlines()[-1]}",
                    hint="look at `ray status` and at the logs of its machines",
                    detail=detail,
                )
            return []
        running, *queued = [batch for _, batch in seat.calls] or [()]
        self._waiting.extendleft(queued)
        lost = []
        for job in running:
            count = self._losses[job.key] = self._losses.get(job.key, 0) + 1
            if count >= ATTEMPTS:
                lost.append(JobResult(job.key, InfraError("died", detail), 0.0, seat.name, count))
            else:
                self._waiting.append((job,))
        return lost


def _check_reachable(address: str) -> None:
    """Raise an OSError where nothing listens at a HOST:PORT: Ray itself would try for minutes."""
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S).close()


def _cannot_simulate(cause: BaseException) -> InfrastructureError:
    """Why an actor will never work, as an error of ours."""
    if isinstance(cause, InfrastructureError):
        return cause
    detail = cause.message if isinstance(cause, RemaError) else str(cause)
    return InfrastructureError(
        f"the machines of the Ray cluster cannot simulate: {detail.strip().splitlines()[-1]}",
        hint="install this version of rema on all of them",
        detail=detail,
    )
