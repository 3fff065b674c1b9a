"""Runs to report on: real pushes by a policy that aims, and runs of the fake world whose outcomes never happened."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluator.engines import SIMULATOR
from evaluator.policy import PolicyFault, PolicySpec
from evaluator.render import images
from evaluator.report import ReportOptions, WrittenReport, write_report
from evaluator.runner import EvaluationConfig, run_evaluation
from evaluator.scenarios import VERSION, update_manifest, write_list
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import valid_actions
from evaluator.sim.spawn import draw_episode, episode_generator
from rema_data import grid
from rema_data.schema import Scenario, Situation
from tests.evaluator.fakes import fake_backend

EPISODES = 24
HOSTILE_NAME = '<img src=x onerror=alert(1)>"&'
HOSTILE_WORDS = "</script><script>alert('policy')</script>"
POLICY = Path(__file__).parent / "scoring_policy.py"


class AimingPolicy:
    """Pushes the target through its middle, a bit beside it or nowhere, by the scenario; is silent about a few."""

    privileged = True

    def act(self, batch: Any, situations: tuple[Situation, ...]) -> list[Any]:
        answers: list[Any] = []
        for number, situation in enumerate(situations):
            target = situation.target
            x = target.x_m - WORLD.scripted_push_offset_m
            if number % 16 == 9:
                answers.append(PolicyFault("exception", HOSTILE_WORDS))
            elif number % 4 == 3:
                answers.append(int(grid.snap(x, -np.sign(target.y_m) * 0.1, 0.0)))
            elif number % 4 == 2:
                answers.append(int(grid.snap(target.x_m, target.y_m, 0.0)))
            else:
                answers.append(int(grid.snap(x, target.y_m, 0.0)))
        return answers


def write_push_list(manifests: Path) -> None:
    """A small list of real pushes."""
    folder = manifests / "scenarios" / VERSION
    scenarios = [
        Scenario("push", "test", index, draw_episode(episode_generator(3, "calibrate", "push", index), "push"))
        for index in range(EPISODES)
    ]
    sha256 = write_list(folder / "push_test.parquet", scenarios)
    update_manifest(
        folder / "manifest.json",
        VERSION,
        "push/test",
        file="push_test.parquet",
        sha256=sha256,
        count=EPISODES,
        seed_domain="calibrate",
    )


def evaluate_pushes(output: Path, policy: PolicySpec) -> None:
    """Real physics, real observations, and the aiming policy under another name."""

    @contextmanager
    def open_policy(*_: Any) -> Iterator[AimingPolicy]:
        yield AimingPolicy()

    from evaluator.policy import digest
    from evaluator.protocol import protocol_hash

    backend = fake_backend(
        observe=observe,
        valid_actions=valid_actions,
        simulator=SIMULATOR,
        open_policy=open_policy,
        policy_digest=digest,
        protocol_hash=protocol_hash,
    )
    config = EvaluationConfig(policy, "push", output, episodes=EPISODES, engine="inline", audit_share=0.0)
    run_evaluation(config, backend=backend)


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An installation with the small list of pushes; pictures are small and films short, so that pages are quick."""
    folder = tmp_path_factory.mktemp("installation")
    write_push_list(folder / "manifests")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REMA_MANIFESTS", str(folder / "manifests"))
        patch.setenv("REMA_HOME", str(folder / "home"))
        patch.setattr(images, "PHOTO", (120, 90))
        patch.setattr(images, "FILM", (80, 60))
        patch.setattr(images, "FRAMES", 3)
        yield folder


@pytest.fixture(scope="module")
def push_run(installation: Path) -> Path:
    """The folder of a real run."""
    run = installation / "runs" / "push"
    evaluate_pushes(run, PolicySpec(HOSTILE_NAME, POLICY, "ScoringPolicy"))
    return run


@pytest.fixture(scope="module")
def push_report(push_run: Path, tmp_path_factory: pytest.TempPathFactory) -> WrittenReport:
    """Its page, one episode of every label."""
    return write_report(push_run, tmp_path_factory.mktemp("page") / "page.html", ReportOptions(per_label=1))


@pytest.fixture
def copied_run(push_run: Path, tmp_path: Path) -> Callable[..., Path]:
    """``copied_run(**summary)``: a copy of the run to be damaged, with other numbers in its summary."""

    def copy(**changes: Any) -> Path:
        folder = tmp_path / "copy"
        folder.mkdir()
        for path in push_run.iterdir():
            if path.is_file():
                (folder / path.name).write_bytes(path.read_bytes())
        summary = json.loads((folder / "summary.json").read_text())
        if changes:
            (folder / "summary.json").write_text(json.dumps({**summary, **changes}))
        return folder

    return copy
