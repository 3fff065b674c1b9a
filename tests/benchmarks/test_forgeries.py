"""Forged runs and entries, at a small size in the fake world: none is believed."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.forged import FORGERIES
from benchmarks.forgeries import judge
from evaluator.engines.base import load_attribute
from evaluator.leaderboard import copies, leaderboard
from evaluator.protocol import protocol_hash
from evaluator.runner import run_evaluation
from evaluator.scenarios import load_list
from rema_data.schema import Situation
from tests.evaluator.fakes import FakePolicyProcess, FakeSimulator, fake_backend, fake_config, fake_observe
from tests.evaluator.runs import EPISODES, use_installation

TRIES = 3


class Expert(FakePolicyProcess):
    """Tries a few actions in a simulator of its own, and answers one that works."""

    def __init__(self) -> None:
        super().__init__()
        situations = [scenario.last_situation() for scenario in load_list("grasp").scenarios]
        self.known = {fake_observe(one).scene_m().tobytes(): one for one in situations}

    def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> list[Any]:
        simulator, answers = FakeSimulator(), []
        for scene, valid in zip(batch.scene, batch.valid, strict=True):
            situation, choices = self.known[scene.tobytes()], np.flatnonzero(valid)[:TRIES].tolist()
            answers.append(next((one for one in choices if simulator.run(situation, one).success), choices[0]))
        return answers


def world(process: FakePolicyProcess, digest: str) -> Any:
    return fake_backend(process, digest=digest * 64, protocol_hash=protocol_hash)


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Path]]:
    """An honest run of rank 1, and one of rank 2. Their names come after those that forgers choose."""
    folder = tmp_path_factory.mktemp("forgeries")
    with pytest.MonkeyPatch.context() as patch:
        use_installation(folder, patch)
        found = []
        for name, digest, process in (("skilled", "e", Expert()), ("unskilled", "f", FakePolicyProcess())):
            config = fake_config(folder / name, episodes=EPISODES, engine="inline")
            run_evaluation(config, backend=world(process, digest))
            found.append(folder / name)
        yield found


judged = partial(judge, engine="inline", backend=fake_backend(protocol_hash=protocol_hash))


@pytest.fixture(autouse=True)
def _no_process_for_the_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("evaluator.rollout.derive", "evaluator.replay.play"):
        monkeypatch.setattr(f"{module}.call_in_child", lambda target: load_attribute(target)())


def test_the_honest_runs_have_ranks_to_lose(honest: list[Path]) -> None:
    board = leaderboard(honest, published=False, backend=fake_backend(protocol_hash=protocol_hash))
    assert [row.rank for row in board.rows] == [1, 2]


@pytest.mark.parametrize("what", FORGERIES)
def test_no_forgery_is_believed(honest: list[Path], tmp_path: Path, what: str) -> None:
    verdict = judged(what, honest, tmp_path / "forged")
    assert not verdict.believed, verdict.how
    assert verdict.how


def test_the_judge_sees_what_is_believed(honest: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the defence taken away, clones of the first push the second down."""
    monkeypatch.setattr(copies, "COPY_SHARE", 1.0)
    verdict = judged("eight clones, each with a changed action", honest, tmp_path / "forged")
    assert verdict.believed and "has rank" in verdict.how
