"""A quick run stops as soon as one policy is significantly better, reports it, and can be continued."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from evaluator.protocol import FIRST_LOOK
from evaluator.run.reading import read_run
from evaluator.runner import run_evaluation
from evaluator.runner.quick import quick_evaluation
from rema_data.errors import InputError, MissingFileError
from rema_data.schema import Failure, Situation, StepOutcome
from tests.evaluator.fakes import FakeSimulator, fake_backend, fake_config
from tests.evaluator.runs import reseal


class Clumsy(FakeSimulator):
    """Fails where the other world fails, and at most other places too."""

    def run(self, situation: Situation, action: int) -> StepOutcome:
        found = super().run(situation, action)
        return found if action % 3 == 0 else replace(found, success=False, failure=Failure.MISSED)


@pytest.fixture
def reference(fake_home: Path, tmp_path: Path) -> Path:
    return run_evaluation(fake_config(tmp_path / "reference", engine="inline"), backend=fake_backend()).folder


def look(output: Path, reference: Path, simulator: type[FakeSimulator], **changes: Any) -> dict[str, Any]:
    backend = fake_backend(digest="other", simulator=f"{simulator.__module__}:{simulator.__name__}")
    config = fake_config(output, engine="inline", **changes)
    found: dict[str, Any] = quick_evaluation(config, reference, backend=backend).summary
    assert json.loads((output / "summary.json").read_text()) == found
    return found


def test_a_worse_policy_is_known_at_the_first_look(tmp_path: Path, reference: Path) -> None:
    summary = look(tmp_path / "worse", reference, Clumsy)
    found = summary["stopped_early"]
    assert summary["episodes"] == FIRST_LOOK and summary["audit"] is None
    assert found["verdict"] == "worse" and found["decided_at"] < FIRST_LOOK
    assert found["difference_interval"][1] < 0 and found["only_reference"] > found["only_ours"] == 0
    assert read_run(tmp_path / "worse").stopped_early


def test_an_equal_policy_is_looked_at_to_the_end_and_stays_undecided(tmp_path: Path, reference: Path) -> None:
    summary = look(tmp_path / "equal", reference, FakeSimulator)
    assert summary["episodes"] == 200
    assert summary["stopped_early"]["verdict"] == "undecided" and summary["stopped_early"]["pairs"] == 200


def test_nothing_is_played_that_has_nothing_to_be_compared_with(tmp_path: Path, fake_home: Path) -> None:
    short = run_evaluation(fake_config(tmp_path / "short", engine="inline", episodes=60), backend=fake_backend()).folder
    summary = look(tmp_path / "equal", short, FakeSimulator)
    assert summary["episodes"] == summary["stopped_early"]["pairs"] == 60


def test_the_run_goes_on_without_a_look_and_is_whole_then(tmp_path: Path, reference: Path) -> None:
    look(tmp_path / "worse", reference, Clumsy)
    assert look(tmp_path / "worse", reference, Clumsy)["episodes"] == FIRST_LOOK  # the same look again plays no more
    backend = fake_backend(digest="other", simulator=f"{__name__}:Clumsy")
    whole = run_evaluation(fake_config(tmp_path / "worse", engine="inline"), backend=backend).summary
    alone = run_evaluation(fake_config(tmp_path / "alone", engine="inline"), backend=backend).summary
    assert "stopped_early" not in whole and whole["successes"] == alone["successes"] and whole["audit"]


def test_runs_that_do_not_compare_are_refused(tmp_path: Path, reference: Path) -> None:
    with pytest.raises(InputError, match="task is"):
        look(tmp_path / "long", reference, FakeSimulator, task="grasp_grasp_push")
    assert not (tmp_path / "long").exists()  # it is known before anything is played
    earlier = {"protocol_hash": "of an earlier version"}
    reseal(reference, identity=earlier, **earlier)
    with pytest.raises(InputError, match="protocol_hash is of an earlier version, here it is"):
        look(tmp_path / "earlier", reference, FakeSimulator)
    assert not (tmp_path / "earlier").exists()
    (reference / "results.parquet").unlink()
    with pytest.raises(MissingFileError):
        look(tmp_path / "other", reference, FakeSimulator)


def test_a_run_to_the_end_keeps_its_rank(tmp_path: Path, reference: Path) -> None:
    whole = run_evaluation(fake_config(tmp_path / "whole", engine="inline"), backend=fake_backend(digest="other"))
    with pytest.raises(InputError, match="is not a quick look"):
        look(tmp_path / "whole", reference, FakeSimulator)
    assert json.loads((tmp_path / "whole" / "summary.json").read_text()) == whole.summary
