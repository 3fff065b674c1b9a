"""Nothing of a simulation stays in the folder of temporary files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from evaluator.engines.child import Child
from rema_data.leftovers import remove_abandoned

WORKER = "tests.evaluator.fakes:FakeSimulator"
ROOT = Path(__file__).parents[3]


def test_a_worker_that_is_killed_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    child = Child("serve", WORKER)
    (folder,) = tmp_path.iterdir()
    environment = Path(f"/proc/{child.process.pid}/environ")
    if environment.exists():
        while not (found := environment.read_bytes()):  # as long as it begins
            time.sleep(0.01)
        assert f"TMPDIR={folder}".encode() in found.split(b"\0")
    (folder / "rema-model-12345678").mkdir()
    child.stop()
    assert list(tmp_path.iterdir()) == []


def test_what_the_worker_of_a_killed_run_left_is_removed_by_the_next(tmp_path: Path) -> None:
    start = f"from evaluator.engines.child import Child\nchild = Child('serve', '{WORKER}')\n"
    code = start + "print('on', flush=True)\ninput()"
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(tmp_path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as run:
        assert run.stdout is not None and run.stdout.readline() == b"on\n"
        remove_abandoned(tmp_path, "rema-worker-")
        assert len(list(tmp_path.iterdir())) == 1
        run.send_signal(signal.SIGKILL)
    remove_abandoned(tmp_path, "rema-worker-")
    assert list(tmp_path.iterdir()) == []


SIMULATE = "from evaluator.sim.world import World\nworld = World(['left'])\nprint('on', flush=True)\ninput()"


@pytest.mark.parametrize("kill", [signal.SIGKILL, None])
def test_the_model_of_a_process_that_simulates_is_removed_with_it_or_by_the_next(
    tmp_path: Path, kill: signal.Signals | None
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SIMULATE],
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(tmp_path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as run:
        assert run.stdout is not None and run.stdin is not None
        assert run.stdout.readline().endswith(b"on\n")
        remove_abandoned(tmp_path, "rema-model-")
        assert len(list(tmp_path.glob("rema-model-*"))) == 1
        if kill is None:
            run.stdin.write(b"\n")
            run.stdin.flush()
        else:
            run.send_signal(kill)
    if kill is not None:
        remove_abandoned(tmp_path, "rema-model-")
    assert list(tmp_path.glob("rema-model-*")) == []


def test_pool_workers_leave_ctrl_c_to_their_parent() -> None:
    code = (
        "import signal, time\nfrom rema_data import interrupts\nfrom evaluator.engines.child import process_pool\n"
        "interrupts.listen()\n"
        "if __name__ == '__main__':\n"
        "    with process_pool(2) as pool:\n"
        "        print('on', flush=True)\n"
        "        while not interrupts.requested(): time.sleep(0.01)\n"
        "        print(pool.submit(abs, -7).result(), flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        assert run.stdout is not None and run.stdout.readline() == "on\n"
        os.killpg(run.pid, signal.SIGINT)
        said, errors = run.communicate(timeout=60)
    assert "Traceback" not in errors and said in ("7\n", "")
