"""The evaluator's end of a policy: its process, asked in batches, and started again if it dies.

Every violation of the contract is counted as a fault.
"""

from __future__ import annotations

import logging
import secrets
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from evaluator.policy.contract import ObservationBatch
from evaluator.policy.faults import Answer, FaultReason, PolicyFault, check_answer, check_maps, reported_fault
from evaluator.policy.load_errors import LoadFailure, load_hint
from evaluator.policy.loading import PolicySpec, check_checkpoint
from evaluator.policy.output import CappedOutput, printable
from evaluator.policy.process import ChildFailure, ChildProcess
from evaluator.policy.sandbox.isolation import Isolation
from evaluator.policy.sandbox.launch_spec import LaunchSpec, runs_beside
from evaluator.policy.sandbox.limits import PolicyLimits
from evaluator.policy.sandbox.private_copy import PrivateCopy
from evaluator.policy.sandbox.snapshot import Snapshot
from evaluator.policy.sandbox.wrapper import check_sandbox
from evaluator.policy.sandbox_hints import Cause, Surroundings, sandbox_hint
from evaluator.policy.starting import CannotStart, Started, WrapperFailed, confine, load
from evaluator.policy.wire import REPLIES, Frame, batch_frame
from rema_data import grid
from rema_data.errors import InputError, SubmissionError
from rema_data.schema import Situation

__all__ = ["PolicyHost"]

_LOG = logging.getLogger(__name__)
_ACTION_BYTES = 3 * 8  # of one returned action: three of the longest numbers
_MAP_BYTES = grid.ACTIONS * 4
_WARNINGS = 3  # failed batches that are logged as warnings: the counts are in the summary


class PolicyHost:
    """A policy in a separate process, as a context manager.

    ``log`` is where the policy's output is appended on closing; None keeps it in memory (``output``). The policy can
    read neither ``run``, the folder of the run (that of ``log`` by default), nor the runs beside it. ``confine`` lets
    the kernel restrict the policy (Landlock, seccomp); ``isolation`` says what was reached. ``sandbox`` is a wrapper's
    command (``evaluator.policy.sandbox.wrapper``). ``restarts`` counts processes after the first one, ``returned`` is
    type and shape of the last array that the policy returned.

    Raises MissingFileError without the checkpoint, InputError for a wrapper that cannot be used and, on entering,
    SubmissionError where the policy does not load. Enter it in the thread that outlives it: on Linux the kernel ends
    the process with the thread that started it.
    """

    def __init__(
        self,
        spec: PolicySpec,
        checkpoint: Path | None,
        device: str = "cpu",
        limits: PolicyLimits | None = None,
        log: Path | None = None,
        *,
        run: Path | None = None,
        confine: bool = True,
        sandbox: str | None = None,
    ) -> None:
        self.spec = spec
        self._checkpoint = checkpoint if spec.copy is not None else check_checkpoint(checkpoint)
        self._device = device
        self._limits = limits or PolicyLimits()
        self._log = log
        self._run = log.parent if run is None and log is not None else run
        self._confined, self._sandbox = confine, sandbox
        check_sandbox(sandbox)
        self._own_copy: PrivateCopy | None = None
        self._output = CappedOutput(log, self._limits.log_head_bytes, self._limits.log_tail_bytes)
        self._child: ChildProcess | None = None
        self._isolation: Isolation | None = None
        self._started: Started | None = None  # by the first process
        self._asked = 0  # observations
        self._waited_s = 0.0  # for processes that are gone
        self._overdrawn: PolicyFault | None = None
        self._warned = 0
        self.restarts = 0
        self.returned = ""

    @property
    def privileged(self) -> bool:
        """Whether the policy is shown the ground truth; known after entering."""
        return self._started is not None and self._started.tags["privileged"]

    @property
    def simulator(self) -> bool:
        """Whether the policy says that it carries a simulator or the scenario lists; known after entering."""
        return self._started is not None and self._started.tags["simulator"]

    @property
    def adapted(self) -> bool:
        """Whether the policy says that it was trained on changed situations; known after entering."""
        return self._started is not None and self._started.tags["adapted"]

    @property
    def isolation(self) -> Isolation:
        """What the sandbox restricts, and its level; known after entering."""
        if self._isolation is None:
            raise InputError("a policy's isolation is not known before its process runs", hint="enter the host first")
        return self._isolation

    @property
    def waited_s(self) -> float:
        """Seconds that all questions together took, the start of the process included."""
        return self._waited_s + (0.0 if self._child is None else self._child.waited_s)

    @property
    def peak_memory_bytes(self) -> int | None:
        """Most memory that the present process held at a time; None where the system does not say."""
        return None if self._child is None else self._child.peak_memory_bytes()

    @property
    def output(self) -> str:
        """The kept part of what the policy printed."""
        return self._output.text()

    @property
    def digest(self) -> str:
        """Digest of the copy that runs (``evaluator.policy.digest``); known after entering."""
        return self._snapshot.digest

    @property
    def _copy(self) -> PrivateCopy:
        copy = self.spec.copy or self._own_copy
        if copy is None:
            raise InputError("a policy is copied when its host is entered", hint="enter the host first")
        return copy

    @property
    def _snapshot(self) -> Snapshot:
        return self._copy.snapshot

    def __enter__(self) -> Self:
        try:
            self._take()
            self._start()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def act(self, batch: ObservationBatch, situations: tuple[Situation, ...] | None = None) -> list[Answer]:
        """An action or a fault for every observation of ``batch``, in its order.

        ``situations`` are needed by a privileged policy (an InputError without them), and never shown to another one.
        """
        if self.privileged and (situations is None or len(situations) != len(batch)):
            raise InputError("a privileged policy needs one situation an observation", hint="pass `situations`")
        if len(batch) == 0:
            return []
        self._asked += len(batch)
        shown = situations if self.privileged else None
        answers = self._answers(batch, shown, self._limits.seconds(len(batch)))
        if isinstance(answers, list):
            return answers
        level = logging.WARNING if self._warned < _WARNINGS else logging.DEBUG
        self._warned += 1
        _LOG.log(level, "policy %s failed on a batch: %s: %s", self.spec.name, answers.reason, answers.detail)
        return [answers] if len(batch) == 1 else self._ask_one_by_one(batch, shown)

    def maps(self, batch: ObservationBatch) -> npt.NDArray[np.float32] | PolicyFault:
        """The policy's scores of all actions, from its optional method ``maps(observations)``.

        float32 (N, 64, 64, K) with K from 1 to 16, or a fault; a batch that failed is not asked again: no rate depends
        on it.
        """
        self._asked += len(batch)
        reply = self._exchange("maps", batch, None, self._limits.seconds(len(batch)), len(batch) * _MAP_BYTES)
        if isinstance(reply, PolicyFault):
            return reply
        header, arrays = reply
        return check_maps(arrays["answer"], len(batch)) if _answered(reply) else self._reported(header)

    def _ask_one_by_one(self, batch: ObservationBatch, shown: tuple[Situation, ...] | None) -> list[Answer]:
        """Find out which observations of a failed batch are faults.

        The result depends on this batch only: in a run that was resumed, another process asked the earlier batches.
        """
        answers: list[Answer] = []
        single_s = min(self._limits.batch_s, self._limits.single_s)
        deaths = 0
        for n in range(len(batch)):
            single = self._answers(batch.one(n), None if shown is None else (shown[n],), single_s)
            answers += single if isinstance(single, list) else [single]
            lost = isinstance(single, PolicyFault) and single.reason != FaultReason.EXCEPTION
            deaths = deaths + 1 if lost else 0
            if deaths >= self._limits.deaths_in_row and isinstance(single, PolicyFault):
                return answers + [single] * (len(batch) - len(answers))
        return answers

    def _answers(
        self, batch: ObservationBatch, shown: tuple[Situation, ...] | None, seconds: float
    ) -> list[Answer] | PolicyFault:
        """Answers of a batch within ``seconds``, or the fault that left it without any."""
        reply = self._exchange("act", batch, shown, seconds, len(batch) * _ACTION_BYTES)
        if isinstance(reply, PolicyFault):
            return reply
        header, arrays = reply
        if _answered(reply):
            answer = arrays["answer"]
            shape = "".join(f", {size}" for size in answer.shape[1:]) or ","
            self.returned = f"{answer.dtype} (N{shape})"
            return check_answer(answer, batch.valid)
        fault = self._reported(header)
        return fault if fault.reason == FaultReason.EXCEPTION else [fault] * len(batch)

    def _reported(self, header: dict[str, Any]) -> PolicyFault:
        fault, around = reported_fault(header), self._surroundings()
        hint = sandbox_hint(Cause.of(header), around)
        detail = f"{fault.detail}; sandbox: {hint}" if hint else fault.detail
        return replace(fault, detail=around.readable(detail))

    def _surroundings(self) -> Surroundings:
        assert self._child is not None
        confined = self._isolation is not None and self._isolation.level != "L1"
        return Surroundings(self.spec.path, self._snapshot, self._child.folder, self._limits, confined)

    def _exchange(
        self, op: str, batch: ObservationBatch, shown: tuple[Situation, ...] | None, seconds: float, reply_bytes: int
    ) -> Frame | PolicyFault:
        """The reply to one question, with at most ``reply_bytes`` of arrays; a new process where the last one died."""
        left_s = self._left_s()
        if left_s <= 0:
            return self._overdraw()
        if self._child is None:
            try:
                self._start()
            except (SubmissionError, InputError) as error:
                return PolicyFault(FaultReason.RESTART, error.message)
            self.restarts += 1
        assert self._child is not None
        number = secrets.randbits(53)  # a count would tell a policy how far the run is
        try:
            reply = self._child.ask(batch_frame(number, batch, shown, op), min(seconds, left_s), reply_bytes)
        except ChildFailure as failure:
            self._drop()
            if failure.reason == FaultReason.TIMEOUT and seconds > left_s:
                return self._overdraw()
            return PolicyFault(failure.reason, str(failure))
        header, _ = reply
        if header.get("op") != REPLIES[op] or header.get("number") != number:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, "the reply belongs to no question")
        return reply

    def _left_s(self) -> float:
        """Seconds that the whole run may still wait for the policy."""
        if self._overdrawn:
            return 0.0
        return self._limits.run_s + self._limits.observation_s * self._asked - self.waited_s

    def _overdraw(self) -> PolicyFault:
        """The fault of every observation from now on."""
        self._drop()
        if self._overdrawn is None:
            self._overdrawn = PolicyFault(
                FaultReason.TIMEOUT,
                f"the policy used up its time: {self._limits.run_s:g} s and {self._limits.observation_s:g} s for each "
                f"of {self._asked} observations",
            )
        return self._overdrawn

    def _take(self) -> None:
        """Make the copy that every process of this host runs from, unless one is held for it."""
        runs = runs_beside(self._run)
        if self.spec.copy is None:
            self._own_copy = PrivateCopy(self.spec, self._checkpoint, runs)
        user = self._copy.user if self._confined else None
        self._launch = LaunchSpec(self._snapshot, self._limits, runs, self._confined, user, self._sandbox)

    def _start(self) -> None:
        self._child = ChildProcess(self._output, self._launch)
        try:
            self._isolation = confine(self._child, self._launch)
            found = Started(self._isolation, load(self._child, self._launch, self.spec.class_name, self._device))
            found.check(self._started)
        except WrapperFailed as failure:
            self._drop()
            raise InputError(
                f"Python did not start in --sandbox {self._sandbox!r}: {failure}",
                hint=f"{printable(self.output).strip()}\nlet it see the folders of Python and of rema",
            ) from None
        except CannotStart as error:
            raise self._error(error.failure) from None
        self._started = self._started or found

    def _error(self, failure: LoadFailure) -> SubmissionError:
        around = self._surroundings()
        sandbox = sandbox_hint(failure.cause, around)
        self._drop()
        path, where = self.spec.path, around.readable(failure.where)
        message = f"policy {self.spec.name} cannot be used: {around.readable(failure.message)}"
        if self.spec.named is not None and failure.explains_itself:
            # The code of an installed policy needs no fix: its checkpoint does.
            return SubmissionError(message, path=path)
        hint = around.readable(load_hint(failure, where or str(path), self.output, self._checkpoint, sandbox))
        if self._log is not None and self._output.total:
            hint += f"\nits output is in {self._log}"
        return SubmissionError(message + (f" ({where})" if where else ""), hint=hint, path=path, where=where)

    def _drop(self) -> None:
        if self._child is not None:
            self._waited_s += self._child.waited_s
            self._child.kill()
            self._child = None

    def _close(self) -> None:
        if self._child is not None:
            self._child.close()
            self._child = None
        self._output.settle()
        if self._own_copy is not None:
            self._own_copy.remove()
            self._own_copy = None


def _answered(reply: Frame) -> bool:
    header, arrays = reply
    return header.get("ok") is True and "answer" in arrays
