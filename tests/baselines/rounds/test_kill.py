"""Killed at any moment and run again, a collection seals the bytes of an undisturbed one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from baselines.rounds.work import work_path
from rema_data.release.folder import find_release
from tests.baselines.rounds.fakes import collect_fake, tree, write_plan

ROOT = Path(__file__).parents[3]


def start(module: str, plan: Path, output: Path, engine: str) -> subprocess.Popen[bytes]:
    arguments = [sys.executable, "-m", module, str(plan), str(output), engine]
    return subprocess.Popen(arguments, cwd=ROOT, stderr=subprocess.PIPE, start_new_session=True)


def committed(output: Path) -> int:
    return sum(path.read_bytes().count(b"\n") for path in (work_path(output, "tiny") / "log").glob("*.jsonl"))


def kill_when(running: subprocess.Popen[bytes], reached: Callable[[], bool]) -> bool:
    """Kill a collection as soon as it got there; whether it was still running then."""
    deadline = time.monotonic() + 120
    while not reached() and running.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.002)
    alive = running.poll() is None
    os.kill(running.pid, signal.SIGKILL)
    running.communicate()
    return alive


def run_to_the_end(module: str, plan: Path, output: Path, engine: str) -> dict[str, str]:
    running = start(module, plan, output, engine)
    _, said = running.communicate(timeout=300)
    assert running.returncode == 0, said.decode()
    return tree(output / "tiny")


FAKE = "tests.baselines.rounds.fakes"


def test_killed_again_and_again(tmp_path: Path) -> None:
    plan = write_plan(tmp_path)
    output, work = tmp_path / "killed", work_path(tmp_path / "killed", "tiny")
    assert kill_when(start(FAKE, plan, output, "process"), lambda: committed(output) >= 2)
    kept = committed(output)
    assert kept >= 2 and not (output / "tiny").exists()
    assert kill_when(start(FAKE, plan, output, "inline"), lambda: (work / "sealing" / "round-1").exists())
    assert committed(output) > kept and not (output / "tiny").exists()
    whole = run_to_the_end(FAKE, plan, output, "inline")
    assert whole == tree(collect_fake(plan, tmp_path / "undisturbed").release.path)
    assert sorted(path.name for path in output.iterdir()) == ["tiny"]


REAL = "tests.baselines.rounds.real"


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["inline", "process"])
def test_killed_at_many_moments_in_the_real_world(tmp_path: Path, engine: str) -> None:
    plan = write_plan(tmp_path, **{"train = 12, val = 3": "train = 8", "train = 11": "train = 6"})
    output = tmp_path / "killed"
    work = work_path(output, "tiny")
    moments: list[Callable[[], bool]] = [
        lambda: (work / "plan.json").exists(),
        *(lambda count=count: committed(output) >= count for count in (1, 2, 4)),  # type: ignore[misc]
        lambda: (work / "sealing" / "round-2" / "grasp_grasp_push" / "train" / "maps.zarr").exists(),
    ]
    alive = [kill_when(start(REAL, plan, output, engine), moment) for moment in moments]
    assert all(alive)
    whole = run_to_the_end(REAL, plan, output, engine)
    other = "process" if engine == "inline" else "inline"
    assert whole == run_to_the_end(REAL, plan, tmp_path / "undisturbed", other)
    assert find_release(output / "tiny").manifest.counts["episodes"] == 14
