"""A fake simulator on the machines of a cluster: its faults are in a file, because environments do not travel."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

from rema_data.schema import Situation, StepOutcome
from tests.evaluator.fakes import FakeSimulator, fake_fingerprint, scenario_number

FAULT_FILE = "REMA_FAKE_CLUSTER"
CLUSTER_SIMULATOR = "tests.evaluator.engines.cluster_world:ClusterSimulator"
OTHER_MACHINES = "tests.evaluator.engines.cluster_world:other_machines"


class ClusterSimulator(FakeSimulator):
    """As its parent; ``{"lose": [3]}`` takes the actor with it that the simulation of scenario 3 belongs to."""

    def __init__(self) -> None:
        super().__init__()
        self.faults = json.loads(Path(os.environ[FAULT_FILE]).read_text())
        if self.faults.get("broken"):
            raise RuntimeError("this simulator cannot be built")

    def run(self, situation: Situation, action: int) -> StepOutcome:
        if scenario_number(situation) in self.faults.get("lose", ()):
            os.kill(os.getppid(), signal.SIGKILL)
        return super().run(situation, action)


def other_machines() -> dict[str, str]:
    """A fingerprint that is another one in every process of a cluster than in the one that asks."""
    return {**fake_fingerprint(), "parameters": "cluster" if "RAY_RAYLET_PID" in os.environ else "here"}
