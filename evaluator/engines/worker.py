"""The child side of a worker process: receives jobs over a socket, sends one message for every finished one.

Started as ``python -m evaluator.engines.worker DESCRIPTOR PARENT MODE TARGET``, never by hand. It imports neither torch
nor pandas, scipy or pyarrow: two workers are to stay small and to start at once.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
import traceback
from multiprocessing.connection import Connection

from evaluator.engines.base import load_attribute

PR_SET_PDEATHSIG = 1

READY, DONE, RAISED, VALUE = "ready", "done", "raised", "value"
"""First element of a message: started; (key, outcome, seconds); traceback; the value of a call."""


def die_with(parent: int) -> None:
    """Ask the kernel to kill this process when its parent dies, and leave at once if that has happened.

    Where the kernel cannot do that, the closed socket ends the worker after its present episode.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def serve(channel: Connection, factory: str) -> None:
    """Simulate the jobs that arrive until the other end closes."""
    simulator = load_attribute(factory)()
    channel.send((READY,))
    clock = time.perf_counter
    while True:
        for job in channel.recv():
            start = clock()
            outcome = simulator.run(job.situation, job.action)
            channel.send((DONE, job.key, outcome, clock() - start))


def main(arguments: list[str]) -> int:
    """Serve jobs (mode ``serve``) or answer with the value of one call (mode ``call``)."""
    descriptor, parent, mode, target = int(arguments[0]), int(arguments[1]), arguments[2], arguments[3]
    os.set_inheritable(descriptor, False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    die_with(parent)
    channel = Connection(descriptor)
    try:
        if mode == "call":
            channel.send((VALUE, load_attribute(target)()))
        else:
            serve(channel, target)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return 0
    except BaseException:
        channel.send((RAISED, traceback.format_exc(limit=-8)))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
