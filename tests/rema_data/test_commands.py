"""Programs that a step waits for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from rema_data.commands import run_command
from rema_data.interrupts import Interrupted, listening

SLEEPER = "import os, sys, time, pathlib; pathlib.Path(sys.argv[1]).write_text(str(os.getpid())); time.sleep(60)"


def has_ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_code_and_output(tmp_path: Path) -> None:
    script = "import os, sys; print(os.getcwd()); print('oh', file=sys.stderr); sys.exit(3)"
    done = run_command([sys.executable, "-c", script], tmp_path)
    assert (done.returncode, done.stdout.split(), done.stderr.split()) == (3, [os.fsencode(tmp_path)], [b"oh"])


@pytest.mark.skipif(os.name != "posix", reason="process groups")
def test_ctrl_c_on_the_group_does_not_reach_the_program() -> None:
    done = run_command([sys.executable, "-c", "import os; print(os.getpgid(0))"])
    assert int(done.stdout) != os.getpgid(0)


def test_a_signal_stops_the_work_and_ends_the_program(tmp_path: Path) -> None:
    noted = tmp_path / "pid"

    def stop() -> None:
        while not (noted.exists() and noted.read_text()):  # so this process listens by then
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=stop)
    thread.start()
    with listening(), pytest.raises(Interrupted):
        run_command([sys.executable, "-c", SLEEPER, str(noted)])
    thread.join()
    assert has_ended(int(noted.read_text()))


@pytest.mark.skipif(os.name != "posix", reason="a shell")
def test_a_program_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    noted = tmp_path / "pid"
    with pytest.raises(subprocess.TimeoutExpired):
        run_command(["sh", "-c", 'echo $$ > "$0"; exec sleep 60', str(noted)], timeout=3)
    assert has_ended(int(noted.read_text()))
