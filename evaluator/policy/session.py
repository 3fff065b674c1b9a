"""A policy's process, kept running: started in its sandbox, asked within its time, and started again after it died."""

from __future__ import annotations

import secrets
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from evaluator.policy.contract import ObservationBatch
from evaluator.policy.faults import FaultReason, PolicyFault
from evaluator.policy.load_errors import LoadFailure, load_hint, printable
from evaluator.policy.loading import PolicySpec, check_checkpoint
from evaluator.policy.output import CappedOutput
from evaluator.policy.process import ChildDeath, ChildNoise, ChildOverLimit, ChildProcess, ChildTimeout
from evaluator.policy.sandbox.isolation import Isolation, isolation_of
from evaluator.policy.sandbox.launch_spec import LaunchSpec
from evaluator.policy.sandbox.limits import PolicyLimits
from evaluator.policy.wire import REPLIES, batch_frame, frame_parts
from rema_data.errors import InputError, SubmissionError
from rema_data.schema import Situation

__all__ = ["PolicySession", "Reply"]

Reply = tuple[dict[str, Any], dict[str, npt.NDArray[np.generic]]]
"""Header and arrays."""


class PolicySession:
    """A policy in its own process, as a context manager.

    Parameters
    ----------
    spec : PolicySpec
    checkpoint : Path or None
    device : str
        Handed to the policy as it is.
    limits : PolicyLimits
    log : Path or None
        Where the policy's output is appended when the session closes; None keeps it in memory (``output``).
    run : Path or None
        Folder of the run: the policy can read neither it nor the runs beside it. The folder of ``log`` by default.
    confine : bool
        Whether the kernel restricts the policy (Landlock, seccomp); ``isolation`` says what was reached.
    sandbox : str or None
        A wrapper's command that is put before the policy's, see ``evaluator.policy.sandbox.wrapper``.

    Attributes
    ----------
    spec : PolicySpec
    restarts : int
        Processes that were started after the first one.

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
        run: Path | None = None,
        confine: bool = True,
        sandbox: str | None = None,
    ) -> None:
        self.spec = spec
        self._checkpoint = check_checkpoint(checkpoint)
        self._device = device
        self._limits = limits or PolicyLimits()
        self._log = log
        run = log.parent if run is None and log is not None else run
        self._launch = LaunchSpec(spec.path, self._checkpoint, self._limits, run, confine, sandbox)
        self._output = CappedOutput(log, self._limits.log_head_bytes, self._limits.log_tail_bytes)
        self._child: ChildProcess | None = None
        self._isolation: Isolation | None = None
        self._privileged: bool | None = None
        self._asked = 0  # observations
        self._waited_s = 0.0  # for processes that are gone
        self._overdrawn: PolicyFault | None = None
        self.restarts = 0

    @property
    def privileged(self) -> bool:
        """Whether the policy is shown the ground truth; known after entering."""
        return self._privileged is True

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

    def exchange(
        self,
        op: str,
        batch: ObservationBatch,
        situations: tuple[Situation, ...] | None,
        seconds: float,
        reply_bytes: int,
    ) -> Reply | PolicyFault:
        """Put one question, in a new process where the last one is gone.

        Parameters
        ----------
        op : {"act", "maps"}
        batch : ObservationBatch
        situations : tuple of Situation, or None
            Shown with it.
        seconds : float
            To wait.
        reply_bytes : int
            Of the arrays in the reply, at most.

        Returns
        -------
        tuple or PolicyFault
            Header and arrays of the reply to this question, or why there is none.
        """
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
                batch_frame(number, batch, situations, op), min(seconds, left_s), reply_bytes
            )
        except ChildTimeout:
            self._drop()
            if seconds > left_s:
                return self._overdraw()
            return PolicyFault(FaultReason.TIMEOUT, f"no answer within {seconds:g} s")
        except (ChildDeath, ChildOverLimit) as death:
            self._drop()
            return PolicyFault(FaultReason.DIED, str(death))
        except ChildNoise as noise:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, str(noise))
        if header.get("op") != REPLIES[op] or header.get("number") != number:
            self._drop()
            return PolicyFault(FaultReason.PROTOCOL, "the reply belongs to no question")
        return header, arrays

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

    def _start(self) -> None:
        spec = self.spec
        self._child = ChildProcess(self._output, self._launch)
        load = {
            "op": "load",
            "path": str(spec.path),
            "class_name": spec.class_name,
            "checkpoint": None if self._checkpoint is None else str(self._checkpoint),
            "device": self._device,
        }
        try:
            self._confine(self._child)
            left_s = self._limits.start_s - self._child.waited_s
            header, _ = self._child.ask(frame_parts(load, {}), left_s, 0)
        except ChildTimeout:
            raise self._error(LoadFailure(f"did not start within {self._limits.start_s:g} s")) from None
        except (ChildDeath, ChildOverLimit, ChildNoise) as death:
            raise self._error(LoadFailure(f"{death} while it started")) from None
        if header.get("ok") is not True:
            raise self._error(LoadFailure.of(header))
        found = header.get("privileged") is True
        if self._privileged not in (None, found):
            # What the run says of the policy was taken from its first process.
            was, now = (f"`privileged` {value}" for value in (self._privileged, found))
            raise self._error(LoadFailure(f"started again it has {now}, at first it had {was}"))
        self._privileged = found

    def _confine(self, child: ChildProcess) -> None:
        """Restrict the process, before anything of the policy is read."""
        sandbox = self._launch.sandbox
        orders = self._launch.orders(child.folder)
        try:
            report, _ = child.ask(frame_parts(orders, {}), self._limits.start_s, 0)
        except (ChildTimeout, ChildDeath, ChildNoise) as error:
            if sandbox is None:
                raise
            self._drop()
            raise InputError(
                f"Python did not start in --sandbox {sandbox!r}: {error or 'it took too long'}",
                hint=f"{printable(self._output.text()).strip()}\nlet it see the folders of Python and of rema",
            ) from None
        found = isolation_of(report, sandbox)
        if self._isolation not in (None, found):
            raise self._error(LoadFailure(f"its sandbox is not the one of its first process: {found}"))
        self._isolation = found

    def _error(self, failure: LoadFailure) -> SubmissionError:
        self._drop()
        if self.spec.named is not None and failure.explains_itself:
            # The code of an installed policy needs no fix: its checkpoint does.
            return SubmissionError(f"policy {self.spec.name} cannot be used: {failure.message}", path=self.spec.path)
        where = failure.where
        hint = load_hint(failure, where or str(self.spec.path), self._output.text(), self._isolation, self._checkpoint)
        if self._log is not None and self._output.total:
            hint += f"\nits output is in {self._log}"
        message = f"policy {self.spec.name} cannot be used: {failure.message}" + (f" ({where})" if where else "")
        return SubmissionError(message, hint=hint, path=self.spec.path, where=where)

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
