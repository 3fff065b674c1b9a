"""The judge's end of a policy: starts its process, asks batches, turns every broken promise into a counted fault."""

from __future__ import annotations

import logging
import secrets
from pathlib import Path
from types import TracebackType
from typing import Self

from evaluator.policy.enclosure import Enclosure
from evaluator.policy.faults import Answer, FaultReason, PolicyFault, check_answer, reported_fault
from evaluator.policy.interface import ObservationBatch
from evaluator.policy.isolation import Isolation, isolation_of
from evaluator.policy.limits import PolicyLimits
from evaluator.policy.loading import PolicySpec, check_checkpoint
from evaluator.policy.output import CappedOutput
from evaluator.policy.process import ChildDeath, ChildGreed, ChildNoise, ChildProcess, ChildTimeout
from evaluator.policy.refusals import Refusal, printable, refusal_hint
from evaluator.policy.wire import batch_frame, frame_parts
from rema_data.errors import InputError, SubmissionError
from rema_data.schema import Situation

__all__ = ["PolicyHost"]

_LOG = logging.getLogger(__name__)
_LONGEST_NUMBER = 8  # bytes of one returned number
_WARNINGS = 3  # failed batches that are logged as warnings: the counts are in the summary


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
        Where the policy's output is appended when the host closes; None keeps it in memory (``output``). It lies in the
        folder of the run, which the policy is kept from.
    walls : bool
        Whether the kernel is asked to deny the policy what it has no need of; what stands then is in ``isolation``.
    sandbox : str or None
        A wrapper's command that is put before the policy's, see ``evaluator.policy.sandbox``.

    Raises
    ------
    MissingFileError
        When the checkpoint is not there.
    InputError
        When the wrapper's command cannot be used.
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
        *,
        walls: bool = True,
        sandbox: str | None = None,
    ) -> None:
        self._spec = spec
        self._checkpoint = check_checkpoint(checkpoint)
        self._device = device
        self._limits = limits or PolicyLimits()
        self._log = log
        self._enclosure = Enclosure(spec.path, self._checkpoint, self._limits, log, walls, sandbox)
        self._output = CappedOutput(log, self._limits.log_head_bytes, self._limits.log_tail_bytes)
        self._child: ChildProcess | None = None
        self._isolation: Isolation | None = None
        self._privileged: bool | None = None
        self._asked = 0
        self._waited_s = 0.0  # for processes that are gone
        self._overdrawn: PolicyFault | None = None
        self._warned = 0
        self.restarts = 0

    @property
    def privileged(self) -> bool:
        """Whether the policy is shown the ground truth; known after entering."""
        return self._privileged is True

    @property
    def isolation(self) -> Isolation:
        """Which walls stand around the policy, and the level that they add up to; known after entering."""
        if self._isolation is None:
            raise InputError("a policy's isolation is not known before its process runs", hint="enter the host first")
        return self._isolation

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
        self._asked += len(batch)
        shown = situations if self._privileged else None
        answers = self._ask(batch, shown, self._limits.batch_s)
        if isinstance(answers, list):
            return answers
        level = logging.WARNING if self._warned < _WARNINGS else logging.DEBUG
        self._warned += 1
        _LOG.log(level, "policy %s failed on a batch: %s: %s", self._spec.name, answers.reason, answers.detail)
        return [answers] if len(batch) == 1 else self._ask_one_by_one(batch, shown)

    def _ask_one_by_one(self, batch: ObservationBatch, shown: tuple[Situation, ...] | None) -> list[Answer]:
        """Find out which observation a failed batch is to be charged to.

        Whatever is charged follows from this batch alone: earlier batches may have been asked by another process, in a
        run that was resumed or on another machine, and the rows must not show it.
        """
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
            header, arrays = self._child.ask(
                batch_frame(number, batch, shown), min(seconds, left_s), len(batch) * 3 * _LONGEST_NUMBER
            )
        except ChildTimeout:
            self._drop()
            if seconds > left_s:
                return self._overdraw()
            return PolicyFault(FaultReason.TIMEOUT, f"no answer within {seconds:g} s")
        except (ChildDeath, ChildGreed) as death:
            self._drop()
            return PolicyFault(FaultReason.DIED, str(death))
        except ChildNoise as noise:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, str(noise))
        if header.get("op") != "acted" or header.get("number") != number:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, "the reply belongs to no question")
        if header.get("ok") is True and "answer" in arrays:
            return check_answer(arrays["answer"], batch.valid)
        fault = reported_fault(header)
        return fault if fault.reason == FaultReason.EXCEPTION else [fault] * len(batch)

    def _left_s(self) -> float:
        """Seconds that the whole run may still wait for the policy."""
        if self._overdrawn:
            return 0.0
        waited_s = self._waited_s + (0.0 if self._child is None else self._child.waited_s)
        return self._limits.run_s + self._limits.observation_s * self._asked - waited_s

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

    def _start(self) -> None:
        spec = self._spec
        self._child = ChildProcess(self._output, self._enclosure)
        load = {
            "op": "load",
            "path": str(spec.path),
            "class_name": spec.class_name,
            "checkpoint": None if self._checkpoint is None else str(self._checkpoint),
            "device": self._device,
        }
        try:
            self._enclose(self._child)
            left_s = self._limits.start_s - self._child.waited_s
            header, _ = self._child.ask(frame_parts(load, {}), left_s, 0)
        except ChildTimeout:
            raise self._refusal(Refusal(f"did not start within {self._limits.start_s:g} s")) from None
        except (ChildDeath, ChildGreed, ChildNoise) as death:
            raise self._refusal(Refusal(f"{death} while it started")) from None
        if header.get("ok") is not True:
            raise self._refusal(Refusal.of(header))
        found = header.get("privileged") is True
        if self._privileged not in (None, found):
            # What the run says of the policy was taken from its first process.
            was, now = (f"`privileged` {value}" for value in (self._privileged, found))
            raise self._refusal(Refusal(f"started again it has {now}, at first it had {was}"))
        self._privileged = found

    def _enclose(self, child: ChildProcess) -> None:
        """Have the walls put up; nothing of the policy was read before."""
        sandbox = self._enclosure.sandbox
        orders = self._enclosure.orders(child.folder)
        try:
            report, _ = child.ask(frame_parts(orders, {}), self._limits.start_s, 0)
        except (ChildTimeout, ChildDeath, ChildNoise) as error:
            if sandbox is None:
                raise
            self._drop()
            raise InputError(
                f"no process of Python came up in --sandbox {sandbox!r}: {error or 'it took too long'}",
                hint=f"{printable(self._output.text()).strip()}\nlet it see the folders of Python and of this package",
            ) from None
        found = isolation_of(report, sandbox)
        if self._isolation not in (None, found):
            raise self._refusal(Refusal(f"other walls stand around it than at first: {found}"))
        self._isolation = found

    def _refusal(self, refusal: Refusal) -> SubmissionError:
        self._drop()
        where = refusal.where
        hint = refusal_hint(
            refusal, where or str(self._spec.path), self._output.text(), self._isolation, self._checkpoint
        )
        if self._log is not None and self._output.total:
            hint += f"\nwhat it printed is in {self._log}"
        message = f"policy {self._spec.name} cannot be used: {refusal.message}" + (f" ({where})" if where else "")
        return SubmissionError(message, hint=hint, path=self._spec.path, where=where)

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
