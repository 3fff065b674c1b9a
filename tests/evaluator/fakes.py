"""A small deterministic world and policy, importable by workers, with faults that a test can order.

Scenario n of a fake list has its target at x = n * 10 micrometres, so a fault can be ordered for a scenario: the
environment variable REMA_FAKE holds JSON such as ``{"die": [3], "die_once": [5], "hang": [7], "raise": [9],
"delay_s": 0.001, "marks": FOLDER}``.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.engines import Job
from evaluator.scenarios import VERSION, update_manifest, write_list
from rema_data import grid
from rema_data.schema import (
    TASKS,
    Failure,
    Grip,
    ObjectSpec,
    Observation,
    Pinch,
    Placement,
    Primitive,
    Scenario,
    Shape,
    Situation,
    StepOutcome,
    pinch_step,
    tool_steps,
)

SIMULATOR = "tests.evaluator.fakes:FakeSimulator"
FAULTS = "REMA_FAKE"


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")


class InThisProcess(Executor):
    """A pool that is none."""

    def map(self, fn: Any, *iterables: Any, **_: Any) -> Any:
        return map(fn, *iterables)


def _text(situation: Situation) -> str:
    """What decides in this world; of a clean situation it is that of before there were suites."""
    return repr(situation).replace(", variation=None", "")


def scenario_number(situation: Situation) -> int:
    return round(situation.target.x_m / 1e-5)


class FakeSimulator:
    def __init__(self) -> None:
        self.faults: dict[str, Any] = json.loads(os.environ.get(FAULTS, "{}"))
        if self.faults.get("broken"):
            raise RuntimeError("this simulator cannot be built")
        self.hoard: list[bytes] = []

    def run(self, situation: Situation, action: int) -> StepOutcome:
        self.misbehave(scenario_number(situation))
        number = _number(f"{_text(situation)} {action}")
        picks = situation.kind.primitive is Primitive.GRASP and not situation.last
        if number % 4 == 0:
            return StepOutcome(False, Failure.MISSED, arm="left", peak_force_n=number % 97 / 7, sim_steps=number % 1000)
        spec = situation.target.spec
        grip = Grip(spec, 0.0, 0.1, 0.01, number % 7 / 3, 0.03) if picks and situation.step < 2 else None
        pinch = Pinch(spec, 0.0, 0.0, 0.01, number % 5 / 3, 0.2, 0.2) if picks and situation.step == 2 else None
        lift_m = np.float64(number % 89 / 13)
        return StepOutcome(
            True,
            None,
            arm="left",
            displacement_m=0.1,
            lift_m=lift_m,
            peak_force_n=number % 97 / 7,
            contact_steps=3,
            sim_steps=number % 1000,
            grip=grip,
            pinch=pinch,
        )

    def misbehave(self, number: int) -> None:
        faults = self.faults
        time.sleep(faults.get("delay_s", 0.0))
        if number in faults.get("die", ()) or (number in faults.get("die_once", ()) and self.first_time(number)):
            os.kill(os.getpid(), signal.SIGKILL)
        if number in faults.get("hang", ()):
            time.sleep(3600)
        if number in faults.get("raise", ()):
            raise ValueError(f"scenario {number} is odd")
        if faults.get("leak_bytes"):
            self.hoard.append(os.urandom(1) * faults["leak_bytes"])

    def first_time(self, number: int) -> bool:
        try:
            Path(self.faults["marks"], str(number)).touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    def close(self) -> None:
        self.hoard.clear()


def fake_fingerprint() -> dict[str, str]:
    return {"pybullet": "0", "parameters": os.environ.get("REMA_FAKE_PARAMETERS", "p"), "probe": "0"}


def fake_valid(task: str, step: int) -> npt.NDArray[np.bool_]:
    valid = np.zeros((grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES), bool)
    valid[grid.inside_valid_square()] = True
    return valid


def fake_observe(situation: Situation) -> Observation:
    pixels = np.frombuffer(hashlib.sha256(_text(situation).encode()).digest(), np.uint8)
    scene = np.tile(pixels.astype(np.uint16), 128).reshape(64, 64)
    depth = np.full((2, 112, 112), situation.step * 100 + len(situation.grips), np.uint16)
    return Observation(scene, depth, depth > 101)


class FakePolicyProcess:
    """Answers as a pure function of the scene; ``faults`` are positions among the answers that it fails on."""

    privileged = False

    def __init__(self, faulty: float = 0.0) -> None:
        self.faulty = faulty
        self.asked = 0

    def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> list[Any]:
        from evaluator.policy.faults import PolicyFault

        assert situations is None
        assert batch.scene.shape == (len(batch.valid), 64, 64) and batch.end_effector.shape[1:] == (112, 112, 4)
        self.asked += len(batch.scene)
        answers: list[Any] = []
        for n, scene in enumerate(batch.scene):
            number = _number(scene.tobytes().hex())
            if number % 1000 < 1000 * self.faulty:
                answers.append(PolicyFault("exception", "ValueError: no idea"))
            else:
                choices = np.flatnonzero(batch.valid[n])
                answers.append(int(choices[number % len(choices)]))
        return answers


def fake_backend(process: FakePolicyProcess | None = None, digest: str = "d", **changes: Any) -> Any:
    from evaluator.runner import Backend

    @contextmanager
    def open_policy(*_: Any) -> Iterator[FakePolicyProcess]:
        yield process or FakePolicyProcess()

    parts: dict[str, Any] = {
        "observe": fake_observe,
        "valid_actions": fake_valid,
        "observation_hash": "fake",
        "simulator": SIMULATOR,
        "fingerprint": "tests.evaluator.fakes:fake_fingerprint",
        "protocol_hash": lambda task, name: f"{task} {name}",
        "policy_digest": lambda policy, checkpoint: digest,
        "open_policy": open_policy,
    }
    return Backend(**{**parts, **changes})


def fake_scenario(task: str, index: int, split: str = "test") -> Scenario:
    shape = list(Shape)[index % 3]
    spec = ObjectSpec(shape, 0.1 + index * 1e-6, 0.02, 0.0 if shape is Shape.I else 0.06, 0.03)
    placements = tuple(Placement(spec, index * 1e-5, step * 0.01, 0.1 * step) for step in range(len(TASKS[task])))
    grips = tuple(Grip(spec, 0.0, 0.1, 0.01, 0.2 * n, 0.03) for n in range(len(tool_steps(task))))
    pinch = Pinch(spec, 0.0, 0.0, 0.01, 0.1, 0.2, 0.2) if pinch_step(task) is not None else None
    return Scenario(task, split, index, placements, grips, pinch)


def fake_jobs(count: int) -> list[Job]:
    return [Job(index, fake_scenario("grasp", index).last_situation(), index) for index in range(count)]


def write_fake_list(manifests: Path, task: str, count: int, split: str = "test") -> None:
    file = f"{task}_{split}.parquet"
    folder = manifests / "scenarios" / VERSION
    sha256 = write_list(folder / file, [fake_scenario(task, index, split) for index in range(count)])
    manifest = folder / "manifest.json"
    update_manifest(manifest, VERSION, f"{task}/{split}", file=file, sha256=sha256, count=count, seed_domain="test")


def fake_config(output: Path, task: str = "grasp", **changes: Any) -> Any:
    from evaluator.policy.loading import PolicySpec
    from evaluator.runner import EvaluationConfig

    fields: dict[str, Any] = {"episodes": 200, "workers": 2, "batch_size": 64}
    return EvaluationConfig(PolicySpec("fake", Path("fake.py"), "Policy"), task, output, **{**fields, **changes})


def main(output: str, task: str, protocol: str) -> None:
    """A whole run in a process of its own, to be killed."""
    from evaluator.runner import run_evaluation

    run_evaluation(fake_config(Path(output), task, protocol=protocol), backend=fake_backend())


if __name__ == "__main__":
    main(*sys.argv[1:])
