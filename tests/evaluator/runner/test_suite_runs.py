"""Runs over a frozen suite in the real world: the same bytes for any workers, order and engine, and the frozen maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from evaluator.policy import resolve
from evaluator.replay import replay
from evaluator.run.records import Answered, Records
from evaluator.runner import EvaluationConfig, questions, run_evaluation
from evaluator.runner.questions import check_faults
from evaluator.scenarios import load_list
from rema_data.errors import IntegrityError, PolicyFailureError
from rema_data.progress import Silent

EPISODES = 40


class Notes(Silent):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def evaluated(output: Path, notes: Notes | None = None, **changes: Any) -> bytes:
    fields: dict[str, Any] = {"episodes": EPISODES, "workers": 2, "version": "hard-v1", "split": "val", **changes}
    run_evaluation(EvaluationConfig(resolve("scripted"), "grasp", output, **fields), notes or Silent())
    return (output / "results.parquet").read_bytes()


@pytest.fixture(scope="module")
def reference(home: Path) -> bytes:
    return evaluated(home / "reference", engine="inline", order="forward")


@pytest.mark.parametrize(("workers", "order"), [(1, "shuffled"), (2, "forward"), (3, "reverse")])
def test_any_number_of_workers_in_any_order(reference: bytes, home: Path, workers: int, order: str) -> None:
    assert evaluated(home / f"workers{workers}", workers=workers, order=order) == reference


def test_a_part_that_is_resumed(reference: bytes, home: Path) -> None:
    for episodes in (15, EPISODES):
        found = evaluated(home / "resumed", episodes=episodes, workers=3)
    assert found == reference


def test_every_row_is_simulated_again(reference: bytes, home: Path) -> None:
    report = replay(home / "reference", engine="inline")
    assert report.verified and not report.differences


def test_axes_on_which_a_policy_fails_are_named() -> None:
    scenarios = load_list("grasp", "val", "hard-v1").scenarios
    asked = Records()
    asked.add_answers(Answered(n, 0, None if scenarios[n].variation.axis == "posts" else 5) for n in range(EPISODES))  # type: ignore[union-attr]
    failed = len(asked.faults)
    with pytest.raises(PolicyFailureError, match=rf"failed on {failed} of {EPISODES} .*; by axis: posts {failed}\n"):
        check_faults(asked, scenarios)


def test_other_maps_than_the_frozen_ones_stop_a_run(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(questions, "observation_sha256", lambda _: "0" * 64)
    with pytest.raises(IntegrityError, match=f"{EPISODES} of {EPISODES} observations are not those"):
        evaluated(home / "others")


def test_a_run_ends_at_the_first_block_of_other_maps(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the policy is asked anything."""
    monkeypatch.setattr(questions, "observation_sha256", lambda _: "0" * 64)
    monkeypatch.setattr(questions, "_BLOCK", 8)
    with pytest.raises(IntegrityError, match="8 of 8 observations are not those"):
        evaluated(home / "first", batch_size=8)
    assert not list((home / "first" / "records").glob("*.jsonl"))


def test_a_few_other_maps_are_noted(reference: bytes, home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(questions, "observation_sha256", lambda _: "0" * 64)
    monkeypatch.setattr(questions, "FLIP_LIMIT", 1.0)
    told = Notes()
    assert evaluated(home / "few", told) == reference
    assert f"{EPISODES} of {EPISODES} observations differ from the frozen ones, by rounding" in told.notes
