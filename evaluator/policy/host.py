"""The judge's end of a policy: starts its process, asks batches, turns every broken promise into a counted fault."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from evaluator.policy.faults import Answer, FaultReason, PolicyFault, check_answer
from evaluator.policy.interface import ObservationBatch
from evaluator.policy.loading import PolicySpec, check_checkpoint
from evaluator.policy.output import CappedOutput
from evaluator.policy.process import ChildDeath, ChildNoise, ChildProcess, ChildTimeout
from evaluator.policy.wire import batch_frame, frame_parts
from rema_data.errors import InputError, SubmissionError
from rema_data.schema import Situation

__all__ = ["PolicyHost", "PolicyLimits"]

_LOG = logging.getLogger(__name__)
_LONGEST_NUMBER = 8  # bytes of one returned number
_OUTPUT_SHOWN = 2000
_WARNINGS = 3  # failed batches that are logged as warnings: the counts are in the summary


@dataclass(frozen=True, slots=True)
class PolicyLimits:
    """What a policy may take.

    Attributes
    ----------
    start_s : float
        From the start of the process until the constructor returned.
    batch_s : float
        For one batch.
    single_s : float
        For one observation of a batch that failed, at most ``batch_s``.
    log_head_bytes, log_tail_bytes : int
        Kept of the beginning and of the end of what the policy prints.
    retried_batches : int
        Failed batches in a row whose observations are asked again one by one; after these a failed batch is charged
        whole, until one succeeds. A batch that raised does not count if any of its observations is answered alone.
    deaths_in_row : int
        While asking one by one: time-outs and deaths in a row after which the rest of the batch is charged too.
    """

    start_s: float = 120.0
    batch_s: float = 60.0
    single_s: float = 20.0
    log_head_bytes: int = 256 << 10
    log_tail_bytes: int = 64 << 10
    retried_batches: int = 3
    deaths_in_row: int = 3


class PolicyHost:
    """A policy in its own process, as a context manager.

    Parameters
    ----------
    spec : PolicySpec
    checkpoint : Path or None
    device : str
        Handed to the policy as it is.
    limits : PolicyLimits
    log : Path or None
        Where the policy's output is appended when the host closes; None keeps it in memory (``output``).

    Raises
    ------
    MissingFileError
        On entering, when the checkpoint is not there.
    SubmissionError
        On entering, when the file does not import, has no such class, or its constructor raises or hangs.

    Notes
    -----
    Enter it in the thread that outlives it: on Linux the kernel ends the process with the thread that started it.
    """

    def __init__(
        self,
        spec: PolicySpec,
        checkpoint: Path | None,
        device: str = "cpu",
        limits: PolicyLimits | None = None,
        log: Path | None = None,
    ) -> None:
        self._spec = spec
        self._checkpoint = check_checkpoint(checkpoint)
        self._device = device
        self._limits = limits or PolicyLimits()
        self._log = log
        self._output = CappedOutput(log, self._limits.log_head_bytes, self._limits.log_tail_bytes)
        self._child: ChildProcess | None = None
        self._privileged = False
        self._number = 0
        self._failed_batches = 0
        self._warned = 0
        self.restarts = 0

    @property
    def privileged(self) -> bool:
        """Whether the policy is shown the ground truth; known after entering."""
        return self._privileged

    @property
    def output(self) -> str:
        """The kept part of what the policy printed."""
        return self._output.text()

    @property
    def output_bytes(self) -> int:
        """Bytes the policy printed so far."""
        return self._output.total

    def __enter__(self) -> Self:
        try:
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

        Parameters
        ----------
        batch : ObservationBatch
        situations : tuple of Situation, or None
            Needed by a privileged policy, and never shown to another one.

        Raises
        ------
        InputError
            When a privileged policy is asked without situations.
        """
        if self._privileged and (situations is None or len(situations) != len(batch)):
            raise InputError("a privileged policy needs one situation an observation", hint="pass `situations`")
        if len(batch) == 0:
            return []
        shown = situations if self._privileged else None
        answers = self._ask(batch, shown, self._limits.batch_s)
        if isinstance(answers, list):
            self._failed_batches = 0
            return answers
        self._failed_batches += 1
        if self._failed_batches > self._limits.retried_batches:
            return [answers] * len(batch)
        level = logging.WARNING if self._warned < _WARNINGS else logging.DEBUG
        self._warned += 1
        _LOG.log(level, "policy %s failed on a batch: %s: %s", self._spec.name, answers.reason, answers.detail)
        if len(batch) == 1:
            return [answers]
        singles = self._ask_one_by_one(batch, shown)
        if answers.reason == FaultReason.EXCEPTION and any(isinstance(answer, int) for answer in singles):
            self._failed_batches = 0  # exceptions are cheap: a policy that raises now and then is asked on
        return singles

    def _ask_one_by_one(self, batch: ObservationBatch, shown: tuple[Situation, ...] | None) -> list[Answer]:
        """Find out which observation a failed batch is to be charged to."""
        answers: list[Answer] = []
        single_s = min(self._limits.batch_s, self._limits.single_s)
        deaths = 0
        for n in range(len(batch)):
            single = self._ask(batch.one(n), None if shown is None else (shown[n],), single_s)
            answers += single if isinstance(single, list) else [single]
            lost = isinstance(single, PolicyFault) and single.reason != FaultReason.EXCEPTION
            deaths = deaths + 1 if lost else 0
            if deaths >= self._limits.deaths_in_row and isinstance(single, PolicyFault):
                return answers + [single] * (len(batch) - len(answers))
        return answers

    def _ask(
        self, batch: ObservationBatch, shown: tuple[Situation, ...] | None, seconds: float
    ) -> list[Answer] | PolicyFault:
        """Answers of a batch within ``seconds``, or the fault that left it without any."""
        if self._child is None:
            try:
                self._start()
            except SubmissionError as error:
                return PolicyFault(FaultReason.RESTART, error.message)
            self.restarts += 1
        assert self._child is not None
        self._number += 1
        try:
            header, arrays = self._child.ask(
                batch_frame(self._number, batch, shown), seconds, len(batch) * 3 * _LONGEST_NUMBER
            )
        except ChildTimeout:
            self._drop()
            return PolicyFault(FaultReason.TIMEOUT, f"no answer within {seconds:g} s")
        except ChildDeath as death:
            self._drop()
            return PolicyFault(FaultReason.DIED, str(death))
        except ChildNoise as noise:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, str(noise))
        if header.get("op") != "acted" or header.get("number") != self._number:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, "the reply belongs to no question")
        if header.get("ok") is True and "answer" in arrays:
            return check_answer(arrays["answer"], batch.valid)
        fault = _reported_fault(header)
        return fault if fault.reason == FaultReason.EXCEPTION else [fault] * len(batch)

    def _start(self) -> None:
        spec = self._spec
        self._child = ChildProcess(self._output)
        order = {
            "op": "load",
            "path": str(spec.path),
            "class_name": spec.class_name,
            "checkpoint": None if self._checkpoint is None else str(self._checkpoint),
            "device": self._device,
        }
        try:
            header, _ = self._child.ask(frame_parts(order, {}), self._limits.start_s, 0)
        except ChildTimeout:
            raise self._refusal(f"did not start within {self._limits.start_s:g} s") from None
        except (ChildDeath, ChildNoise) as death:
            raise self._refusal(f"{death} while it started") from None
        if header.get("ok") is not True:
            message = _printable(header.get("message", "could not be loaded"))
            raise self._refusal(message, _printable(header.get("where", "")), _printable(header.get("traceback", "")))
        self._privileged = header.get("privileged") is True

    def _refusal(self, message: str, where: str = "", trace: str = "") -> SubmissionError:
        self._drop()
        place = f" ({where})" if where else ""
        printed = trace or _printable(self._output.text()[-_OUTPUT_SHOWN:]).strip()
        hint = f"mend {where or self._spec.path} and run the same command again"
        if self._log is not None and self._output.total:
            hint = f"what it printed is in {self._log}\n{hint}"
        return SubmissionError(
            f"policy {self._spec.name} cannot be used: {message}{place}",
            hint=f"{printed}\n{hint}" if printed else hint,
            path=self._spec.path,
            where=where,
        )

    def _drop(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child = None

    def _close(self) -> None:
        if self._child is not None:
            self._child.close()
            self._child = None
        self._output.settle()


def _reported_fault(header: dict[str, Any]) -> PolicyFault:
    """The fault that a policy's process reports about itself."""
    known = (FaultReason.EXCEPTION, FaultReason.SHAPE, FaultReason.DTYPE)
    reason = header.get("reason")
    where = header.get("where")
    detail = _printable(header.get("message", "")) + (f" ({_printable(where)})" if where else "")
    return PolicyFault(FaultReason(reason) if reason in known else FaultReason.PROTOCOL, detail)


def _printable(said: object) -> str:
    """What a policy said, fit for a terminal and for a record: no control characters, no lone surrogates, not long."""
    text = str(said)[:_OUTPUT_SHOWN].encode(errors="backslashreplace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)
