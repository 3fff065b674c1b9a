"""The policy's process is killed from outside in the middle of a run: the rows do not show it."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import psutil
import pytest

from evaluator.policy import PolicyHost, PolicySpec, digest
from evaluator.runner import run_evaluation
from rema_data.progress import Silent
from tests.evaluator.fakes import fake_backend, fake_config

from .conftest import WritePolicy

BATCHES = 6
SLOW = """
if n > 1: time.sleep(0.2)
cells = [int(round(float(scene.sum()) * 1e4)) for scene in observations.scene]
return [[20 + cell // 16 % 20, 20 + cell // 320 % 20, cell % 16] for cell in cells]
"""


class Killer(Silent):
    """Kills the policy's process between two questions, and again while it computes; then interrupts the run."""

    def __init__(self, interrupt: bool) -> None:
        self.interrupt = interrupt
        self.name, self.answered = "", 0
        self.killed: list[int] = []
        self.threads: list[threading.Timer] = []

    def phase(self, name: str, total: int) -> None:
        self.name = name

    def advance(self, n: int) -> None:
        if self.name != "infer":
            return
        self.answered += 1
        if self.answered == 1:
            self.kill()
        elif self.answered == 2:
            self.threads.append(threading.Timer(0.1, self.kill))
            self.threads[0].start()
        elif self.interrupt:
            raise KeyboardInterrupt

    def kill(self) -> None:
        for child in psutil.Process().children():
            if any(word.endswith("sandbox.kernel") for word in child.cmdline()):
                child.kill()
                self.killed.append(child.pid)


@pytest.fixture
def sealed(fake_home: Path, write_policy: WritePolicy) -> Any:
    """``sealed(name, sink)`` evaluates the slow policy into a folder, and gives what is sealed of it."""
    policy: PolicySpec = write_policy(SLOW)
    backend = fake_backend(
        open_policy=lambda *given: PolicyHost(policy, None, "cpu", log=given[3]),
        policy_digest=lambda *given: digest(policy, None),
    )

    def evaluate(name: str, sink: Silent | None = None) -> bytes:
        config = fake_config(fake_home / name, episodes=16 * BATCHES, batch_size=16, engine="inline", audit_share=0.0)
        run_evaluation(config, sink, backend=backend)
        return b"".join((fake_home / name / file).read_bytes() for file in ("results.parquet", "actions.bin"))

    return evaluate


def test_the_same_bytes_after_kills_and_a_resume(sealed: Any, fake_home: Path) -> None:
    undisturbed = sealed("undisturbed")
    for resumed in (False, True):
        killer = Killer(interrupt=not resumed)
        if resumed:
            assert sealed("killed", killer) == undisturbed
        else:
            with pytest.raises(KeyboardInterrupt):
                sealed("killed", killer)
        for thread in killer.threads:
            thread.join()
        assert killer.killed
    summary = json.loads((fake_home / "killed" / "summary.json").read_text())
    assert summary["policy_errors"] == summary["unfinished"] == 0
    assert len(json.loads((fake_home / "killed" / "run.json").read_text())["segments"]) == 2
