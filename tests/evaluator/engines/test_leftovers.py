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

from evaluator.engines import abandoned
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
        assert f"TMPDIR={folder}".encode() in environment.read_bytes().split(b"\0")
    (folder / "rema-urdf-12345678").mkdir()
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


def test_models_of_dead_processes_are_removed_and_those_of_live_ones_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    now = time.time()
    for name, age_s in (("rema-urdf-dead0000", 100.0), ("rema-urdf-live0000", 10.0), ("other-urdf", 100.0)):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (now - age_s, now - age_s))
    monkeypatch.setattr(abandoned, "_simulates_since", lambda process: now - 50 if process.pid == os.getpid() else None)
    abandoned.remove_models()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other-urdf", "rema-urdf-live0000"]


def test_a_process_with_the_physics_is_seen() -> None:
    code = "import time, sys, pybullet\nprint('on', flush=True)\nsys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        assert process.stdout is not None and b"on" in process.stdout.readline()
        import psutil

        if hasattr(psutil.Process, "memory_maps"):
            began = abandoned._simulates_since(psutil.Process(process.pid))
            assert began is not None and abs(began - time.time()) < 600
        process.kill()


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
