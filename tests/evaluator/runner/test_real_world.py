"""The real world on the frozen list: the same bytes for any workers, order, engine, and for a run that was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from evaluator.policy import resolve
from evaluator.runner import EvaluationConfig, run_evaluation

EPISODES = 30


def table(output: Path, **changes: Any) -> bytes:
    fields: dict[str, Any] = {"episodes": EPISODES, "workers": 2, **changes}
    run_evaluation(EvaluationConfig(resolve("scripted"), "grasp", output, **fields))
    return (output / "results.parquet").read_bytes()


@pytest.fixture(scope="module")
def reference(home: Path) -> bytes:
    return table(home / "reference", engine="inline", order="forward")


@pytest.mark.parametrize(("workers", "order"), [(1, "shuffled"), (2, "reverse"), (3, "forward")])
def test_any_number_of_workers_in_any_order(reference: bytes, home: Path, workers: int, order: str) -> None:
    assert table(home / f"workers{workers}", workers=workers, order=order) == reference


def test_killed_and_resumed(reference: bytes, home: Path) -> None:
    output = home / "killed"
    arguments = ["evaluate", "scripted", "--task", "grasp", "--episodes", str(EPISODES), "--workers", "1"]
    command = [sys.executable, "-m", "evaluator.cli", *arguments, "--output", str(output)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    journal = output / "records" / "outcomes-0001.jsonl"
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as evaluation:
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline and not (journal.exists() and journal.read_bytes().count(b"\n") >= 5):
            time.sleep(0.005)
        evaluation.send_signal(signal.SIGKILL)
    assert 5 <= journal.read_bytes().count(b"\n") < EPISODES
    assert not (output / "results.parquet").exists()
    assert table(output) == reference
    assert len(list((output / "records").glob("outcomes-*.jsonl"))) == 2
