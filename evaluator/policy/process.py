"""One child process with deadlines: started, asked, killed with all that it started."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import evaluator
from evaluator.policy.guard import Guard, end_family
from evaluator.policy.output import CappedOutput
from evaluator.policy.wire import WireError, frame_parts, read_frame

__all__ = ["ChildDeath", "ChildNoise", "ChildProcess", "ChildTimeout"]

_PIPE_BYTES = 1 << 20
_REPLY_HEADER = 1 << 20
_GOODBYE_S = 2.0
_POLL_S = 0.005
_SLICE_S = 1.0
_KEPT_VARIABLES = (
    "PATH", "HOME", "USER", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "VIRTUAL_ENV", "CONDA_PREFIX", "PYTHONPATH",
    "LD_LIBRARY_PATH", "CUDA_HOME", "CUDA_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES", "OMP_NUM_THREADS", "MKL_NUM_THREADS",
    "SYSTEMROOT",
)  # fmt: skip
"""All that a policy inherits: enough to find its libraries and its device, nothing about the run."""


class ChildTimeout(Exception):
    """No reply before the deadline."""


class ChildDeath(Exception):
    """The process ended."""


class ChildNoise(Exception):
    """The process wrote what is no reply."""


class _Budget:
    """Seconds to wait, counted in slices: a judge that was suspended meanwhile (Ctrl-Z) charges one slice at most."""

    def __init__(self, seconds: float) -> None:
        self._left = seconds

    def wait(self, read: int | None = None, write: int | None = None) -> None:
        """Return when the end can be read (written), or raise ChildTimeout."""
        readable, writable = ([] if end is None else [end] for end in (read, write))
        while True:
            start, allowed = time.monotonic(), max(0.0, min(self._left, _SLICE_S))
            ready = any(select.select(readable, writable, [], allowed))
            self._left -= min(time.monotonic() - start, _SLICE_S)
            if ready:
                return
            if self._left <= 0:
                raise ChildTimeout


class ChildProcess:
    """``python -m evaluator.policy.child`` in its own session, with pipes for questions and replies.

    Parameters
    ----------
    output : CappedOutput
        Takes what the process prints.
    """

    def __init__(self, output: CappedOutput) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="rema-policy-"))
        request_end, self._requests = os.pipe()
        self._replies, reply_end = os.pipe()
        log_end = output.open_pipe()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "evaluator.policy.child", str(request_end), str(reply_end)],
                stdin=subprocess.DEVNULL,
                stdout=log_end,
                stderr=log_end,
                pass_fds=(request_end, reply_end),
                env=_environment(self._folder),
                cwd=self._folder,
                start_new_session=True,
            )
            try:
                self._guard = Guard(self._process.pid, self._folder)
            except BaseException:
                end_family(self._process, self._folder)
                raise
        except BaseException:
            os.close(self._requests)
            os.close(self._replies)
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        finally:
            for end in (request_end, reply_end, log_end):
                os.close(end)
        os.set_blocking(self._requests, False)
        os.set_blocking(self._replies, False)
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._requests, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def ask(
        self, parts: Iterable[bytes | memoryview], seconds: float, reply_bytes: int
    ) -> tuple[dict[str, Any], dict[str, npt.NDArray[np.generic]]]:
        """Send a frame and wait for one.

        Raises
        ------
        ChildTimeout
            When the reply is not complete within ``seconds``.
        ChildDeath
            When the process ended.
        ChildNoise
            When it replied with something else than a frame with at most ``reply_bytes`` of arrays.
        """
        budget = _Budget(seconds)
        try:
            for part in parts:
                self._write(memoryview(part), budget)
            return read_frame(lambda count: self._read(count, budget), _REPLY_HEADER, reply_bytes)
        except (BrokenPipeError, EOFError) as error:
            raise ChildDeath(self._obituary()) from error
        except WireError as error:
            raise ChildNoise(f"the reply cannot be read: {error}") from error

    def _write(self, view: memoryview, budget: _Budget) -> None:
        while view:
            budget.wait(write=self._requests)
            with contextlib.suppress(BlockingIOError):
                view = view[os.write(self._requests, view[:_PIPE_BYTES]) :]

    def _read(self, count: int, budget: _Budget) -> bytearray:
        data = bytearray()
        while len(data) < count:
            budget.wait(read=self._replies)
            with contextlib.suppress(BlockingIOError):
                chunk = os.read(self._replies, count - len(data))
                if not chunk:
                    raise EOFError
                data += chunk
        return data

    def _obituary(self) -> str:
        found = self._await_end(_GOODBYE_S)
        if found is None:
            return "closed its pipe to the judge"
        if found.si_code == os.CLD_EXITED:
            return f"ended with exit code {found.si_status}"
        return f"ended with signal {signal.Signals(found.si_status).name}"

    def _await_end(self, seconds: float) -> os.waitid_result | None:
        """How the process ended, without giving its number back: ``kill`` still needs it for the group."""
        deadline = time.monotonic() + seconds
        while True:
            found = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            if found is not None or time.monotonic() > deadline:
                return found
            time.sleep(_POLL_S)

    def close(self) -> None:
        """Say goodbye, then end the process and everything that it started."""
        with contextlib.suppress(OSError, ChildTimeout):
            for part in frame_parts({"op": "close"}, {}):
                self._write(memoryview(part), _Budget(_GOODBYE_S))
            self._await_end(_GOODBYE_S)
        self.kill()

    def kill(self) -> None:
        """End the process, its group and its descendants at once."""
        end_family(self._process, self._folder)
        self._guard.dismiss()
        for end in (self._requests, self._replies):
            with contextlib.suppress(OSError):
                os.close(end)


def _environment(folder: Path) -> dict[str, str]:
    """A small environment: the same for every run, with the folder of this package importable."""
    kept = {name: os.environ[name] for name in _KEPT_VARIABLES if name in os.environ}
    root = str(Path(evaluator.__file__).resolve().parent.parent)
    inherited = [entry for entry in kept.pop("PYTHONPATH", "").split(os.pathsep) if entry]
    # A wheel's folder is on the path of the child anyway; naming it would put it before the standard library.
    own = [] if Path(root).name in ("site-packages", "dist-packages") else [root]
    paths = [os.path.abspath(entry) for entry in (*own, *inherited)]
    return {
        **kept,
        **({"PYTHONPATH": os.pathsep.join(paths)} if paths else {}),
        "PYTHONHASHSEED": "0",  # the order of sets must not differ between two runs
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUNBUFFERED": "1",
        "TMPDIR": str(folder),
    }
