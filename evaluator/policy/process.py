"""One child process with deadlines: started, asked, and killed together with every process that it started."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import subprocess
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import psutil

from evaluator.engines.base import signal_name
from evaluator.policy.faults import FaultReason
from evaluator.policy.output import CappedOutput
from evaluator.policy.sandbox.cleanup import CleanupShell, descendants, end_family, remove_folder
from evaluator.policy.sandbox.launch_spec import LaunchSpec
from evaluator.policy.sandbox.resource_monitor import ResourceMonitor
from evaluator.policy.wire import Frame, WireError, frame_parts, read_frame
from rema_data import interrupts

__all__ = ["ChildFailure", "ChildProcess"]

_PIPE_BYTES = 1 << 20
_REPLY_HEADER = 1 << 20
_GOODBYE_S = 2.0
_POLL_S = 0.005
_SLICE_S = 0.5
"""Time between two looks at the resources that the policy uses, while the evaluator waits."""


class ChildFailure(Exception):
    """No reply: the time is over, the process ended or exceeded a limit, or it wrote something else."""

    def __init__(self, reason: FaultReason, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


class ChildProcess:
    """A policy's process (``evaluator.policy.sandbox.kernel``), in its own session, asked over its standard streams.

    ``output`` takes what it prints, ``folder`` is its temporary folder, and ``waited_s`` the time of all questions.
    """

    def __init__(self, output: CappedOutput, launch: LaunchSpec) -> None:
        self.waited_s = 0.0
        # Resolved: it is compared with the folders that the policy may reach.
        self.folder = Path(tempfile.mkdtemp(prefix="rema-policy-")).resolve()
        request_end, self._requests = os.pipe()
        self._replies, reply_end = os.pipe()
        log_end = output.open_pipe()
        try:
            self._process = subprocess.Popen(
                launch.command(self.folder),
                stdin=request_end,
                stdout=reply_end,
                stderr=log_end,
                env=launch.environment(self.folder),
                cwd=self.folder,
                start_new_session=True,
            )
            try:
                self._cleanup = CleanupShell(self.folder, self._process.pid)
            except BaseException:
                end_family(self._process, self.folder)
                raise
        except BaseException:
            os.close(self._requests)
            os.close(self._replies)
            remove_folder(self.folder)
            raise
        finally:
            for end in (request_end, reply_end, log_end):
                os.close(end)
        self._monitor = ResourceMonitor(self._process.pid, self.folder, launch.limits)
        os.set_blocking(self._requests, False)
        os.set_blocking(self._replies, False)
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._requests, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    def peak_memory_bytes(self) -> int | None:
        """Most memory that the process held at a time; None where the system does not say."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            status = Path(f"/proc/{self._process.pid}/status").read_text()
            return 1024 * int(status.split("VmHWM:")[1].split()[0])
        return None

    def ask(self, parts: Iterable[bytes | memoryview], seconds: float, reply_bytes: int) -> Frame:
        """Send a frame, and wait ``seconds`` for one with at most ``reply_bytes`` of arrays, or raise ChildFailure."""
        if excess := self._monitor.excess_of_disk():
            raise ChildFailure(FaultReason.DIED, excess)
        self._limit_s = self._left_s = seconds
        try:
            for part in parts:
                self._write(memoryview(part))
            return read_frame(self._read, _REPLY_HEADER, reply_bytes)
        except (BrokenPipeError, EOFError) as error:
            raise ChildFailure(FaultReason.DIED, self._how_it_ended()) from error
        except WireError as error:
            raise ChildFailure(FaultReason.PROTOCOL, f"the reply cannot be read: {error}") from error
        finally:
            self.waited_s += seconds - self._left_s

    def _wait(self, read: tuple[int, ...] = (), write: tuple[int, ...] = ()) -> None:
        """Return when the pipe can be read (written), or raise ChildFailure.

        Time is counted in slices: one that was suspended meanwhile (Ctrl-Z) counts as one at most.
        """
        while True:
            interrupts.check()
            start, allowed = time.monotonic(), max(0.0, min(self._left_s, _SLICE_S))
            ready = any(select.select(read, write, (), allowed))
            self._left_s -= min(time.monotonic() - start, _SLICE_S)
            if ready:
                return
            if excess := self._monitor.excess():
                raise ChildFailure(FaultReason.DIED, excess)
            if self._left_s <= 0:
                raise ChildFailure(FaultReason.TIMEOUT, f"no answer within {self._limit_s:g} s")

    def _write(self, view: memoryview) -> None:
        while view:
            self._wait(write=(self._requests,))
            with contextlib.suppress(BlockingIOError):
                view = view[os.write(self._requests, view[:_PIPE_BYTES]) :]

    def _read(self, count: int) -> bytearray:
        data = bytearray()
        while len(data) < count:
            self._wait(read=(self._replies,))
            with contextlib.suppress(BlockingIOError):
                chunk = os.read(self._replies, count - len(data))
                if not chunk:
                    raise EOFError
                data += chunk
        return data

    def _how_it_ended(self) -> str:
        found = self._await_end(_GOODBYE_S)
        if found is None:
            return "closed its pipe to the evaluator"
        if found.si_code == os.CLD_EXITED:
            return f"ended with exit code {found.si_status}"
        return f"ended with signal {signal_name(found.si_status)}"

    def _await_end(self, seconds: float) -> os.waitid_result | None:
        """How the process ended, without giving its number back: ``kill`` still needs it for the group."""
        deadline = time.monotonic() + seconds
        while True:
            found = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            if found is not None or time.monotonic() > deadline:
                return found
            time.sleep(_POLL_S)

    def close(self) -> None:
        """Ask the process to end, then end it and everything that it started."""
        known = descendants(self._process)  # once it has ended, its children have no parent to be found by
        self._left_s = _GOODBYE_S
        if not interrupts.requested():  # else there is no time for a goodbye
            with contextlib.suppress(OSError, ChildFailure):
                for part in frame_parts({"op": "close"}):
                    self._write(memoryview(part))
                self._await_end(_GOODBYE_S)
        self.kill(known)

    def kill(self, known: Iterable[psutil.Process] = ()) -> None:
        """End the process, its group, its descendants, and those of them that are ``known`` already, at once."""
        end_family(self._process, self.folder, known)
        self._cleanup.dismiss()
        for end in (self._requests, self._replies):
            with contextlib.suppress(OSError):
                os.close(end)
