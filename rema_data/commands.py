"""Other programs that a step of the work waits for."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from rema_data import interrupts

__all__ = ["run_command"]


def run_command(
    command: Sequence[str], folder: Path | None = None, timeout: float | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run a program to its end and return its exit code and output.

    The program is in a session of its own: Ctrl-C stops the work that waits for it, and never ends only the program,
    which would look like a fault of what it was given.

    Raises
    ------
    interrupts.Interrupted
        A signal asked this process to stop; the program is ended.
    subprocess.TimeoutExpired
        After ``timeout`` seconds; the program is ended.
    OSError
        It cannot be started.
    """
    waits = None if timeout is None else max(1, round(timeout / interrupts.POLL_S))
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            while True:
                interrupts.check()
                try:
                    said, complained = process.communicate(timeout=interrupts.POLL_S)
                except subprocess.TimeoutExpired:
                    if waits is not None and (waits := waits - 1) <= 0:
                        raise subprocess.TimeoutExpired(command, timeout or 0.0) from None
                else:
                    return subprocess.CompletedProcess(command, process.returncode, said, complained)
        except BaseException:
            process.kill()
            raise
