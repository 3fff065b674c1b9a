"""The parent side of one worker process: a fresh interpreter, alone in its group, silent, killed with its parent."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection
from typing import Any

from evaluator.engines.base import signal_name
from evaluator.engines.worker import VALUE, die_with
from rema_data import interrupts
from rema_data.errors import InfrastructureError, StorageError
from rema_data.leftovers import temporary_folder

__all__ = ["Child", "call_in_child", "process_pool"]

THREAD_CAPS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")
HUGE_PAGES = "glibc.malloc.hugetlb=1"
"""Bullet clears 8 MB of memory whenever a world is built: huge pages take a fifth off the time to build it."""
_TAIL_BYTES = 2000


class Child:
    """A started worker and the socket to it; ``mode`` and ``target`` are those of ``evaluator.engines.worker``.

    The child is a fresh interpreter and no fork: it inherits neither threads nor simulators. Its thread counts are in
    its environment before it imports anything, its standard output is discarded and its errors go to an unnamed file.
    """

    def __init__(self, mode: str, target: str) -> None:
        ours, theirs = socket.socketpair()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by stop
        self._folder = ExitStack()  # a worker that is killed does not remove its temporary files
        environment = {
            **os.environ,
            "TMPDIR": str(self._folder.enter_context(temporary_folder("rema-worker-"))),
            **dict.fromkeys(THREAD_CAPS, "1"),
            "GLIBC_TUNABLES": ":".join(filter(None, (os.environ.get("GLIBC_TUNABLES"), HUGE_PAGES))),
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
            "PYTHONSAFEPATH": "1",  # a file of the working folder must not stand in for a module
        }
        descriptor = theirs.fileno()
        arguments = [str(descriptor), str(os.getpid()), mode, target]
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "evaluator.engines.worker", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._log,
                env=environment,
                pass_fds=(descriptor,),
                start_new_session=True,
            )
        self.channel = Connection(ours.detach())

    def stop(self, grace_s: float = 0.0) -> str:
        """Close the socket, wait ``grace_s`` for the child to leave, then kill its whole group and reap it.

        Returns the exit status, and the end of what the child wrote to standard error.
        """
        self.channel.close()
        if grace_s:
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(grace_s)
        # The group has the child's id, which stays taken until the child is reaped below.
        if self.process.returncode is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
        status = self.process.wait()
        self._folder.close()
        with self._log as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - _TAIL_BYTES))
            printed = log.read().decode(errors="replace").strip()
        how = f"killed by {signal_name(-status)}" if status < 0 else f"exit {status}"
        return f"{how}\n{printed}" if printed else how


def call_in_child(target: str, timeout_s: float = 120.0) -> Any:
    """Value of ``target()`` from a fresh process. Raises InfrastructureError where it raised, died or hung."""
    child = Child("call", target)
    message: tuple[Any, ...] = ()
    try:
        deadline = time.monotonic() + timeout_s
        while not child.channel.poll(interrupts.POLL_S):
            interrupts.check()
            if time.monotonic() > deadline:
                break
        else:
            with suppress(EOFError, OSError):
                message = child.channel.recv()
    finally:
        end = child.stop(grace_s=1.0 if message else 0.0)
    if message and message[0] == VALUE:
        return message[1]
    reason = message[1] if message else end
    raise InfrastructureError(
        f"{target} did not answer in a separate process: {reason.strip().splitlines()[-1]}",
        hint="check the installation: pip install --force-reinstall rema",
        target=target,
        detail=reason,
    )


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Fresh interpreters for Python calls, which end with this process and leave Ctrl-C to it.

    Raises StorageError where the system has no shared memory for them.
    """
    spawn = multiprocessing.get_context("spawn")
    try:
        pool = ProcessPoolExecutor(workers, mp_context=spawn, initializer=_begin, initargs=(os.getpid(),))
    except OSError as error:
        raise StorageError(
            f"processes cannot work together here: /dev/shm cannot be used: {error.strerror or error}",
            hint="mount it as memory that may be written; for a container: docker run --shm-size 64m",
            path="/dev/shm",
        ) from error
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited: they import for a second or two
    try:
        for _ in range(workers):
            pool.submit(int)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return pool


def _begin(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    die_with(parent)
