"""Beside Table 2 of the paper."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

from rema_data.errors import IntegrityError, MissingFileError
from rema_data.schema import TASKS
from rema_data.statistics.count import Statistics, StepCount
from rema_data.statistics.paper import Counts, compare, executed_steps, published_counts

PUBLISHED = Path(__file__).resolve().parents[3] / "manifests" / "published"


def row(task: str, step: int, reached: int, positives: int, skill: str = "grasp", split: str = "train") -> StepCount:
    return StepCount(1, task, split, step, step == len(TASKS[task]) - 1, skill, "random", reached, positives)


OURS = Statistics(
    "tiny",
    "0" * 64,
    (
        row("grasp", 0, 100, 30),
        row("grasp", 0, 20, 5, split="val"),
        row("grasp_push", 0, 100, 90),
        row("grasp_push", 1, 90, 10, "grasp_push"),
        row("grasp_grasp_push", 0, 10, 9),
        row("grasp_grasp_push", 1, 9, 8),
        row("grasp_grasp_push", 2, 8, 7, "grasp_grasp"),
        row("grasp_grasp_push", 3, 7, 2, "grasp_grasp_push"),
    ),
    (),
)


def test_both_sums_and_the_tool_picks_between_them() -> None:
    found = compare(OURS)
    rows = {item.name: item for item in found.tasks}
    assert list(rows) == list(TASKS)
    assert rows["grasp"].paper == Counts(28_533, 22_129) and rows["grasp"].ours == Counts(35, 85)
    assert rows["push"].ours is None and rows["grasp_grasp_push"].paper is None
    assert found.total.paper is not None and found.total.paper.rows == 118_870
    assert found.total.ours == Counts(35 + 10 + 2, 85 + 80 + 5)
    picks, pinches = found.earlier
    assert (picks.name, picks.ours) == ("tool picks", Counts(107, 12))
    assert (pinches.name, pinches.ours) == ("tool pinches", Counts(7, 1))
    assert found.executed.ours is not None and found.executed.ours.rows == sum(step.reached for step in OURS.steps)


def test_remarks_say_what_the_paper_counts() -> None:
    text = "\n".join(compare(OURS).remarks)
    for words in (
        "sum to 118,870; it collected 108,000 episodes",
        "push: 24,000 rows of 24,000 episodes",
        "grasp: 50,662 rows, 14,662 more than its 36,000 episodes",
        "(about 71.3K)",
        "would be about 175K: grasp 36.0K + push 24.0K + grasp_grasp 69.8K + grasp_push 45.7K",
    ):
        assert words in text


def test_executed_steps() -> None:
    """Half of the first picks and half of the second ones succeed: a quarter of the episodes reach the last step."""
    assert executed_steps({"grasp_grasp": 25, "push": 7}, {"grasp_grasp": 100, "push": 7}) == {
        "grasp_grasp": pytest.approx(100 + 50 + 25),
        "push": 7,
    }


def test_numbers_come_from_the_published_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    with pytest.raises(MissingFileError, match=r"table2\.json"):
        published_counts()
    shutil.copytree(PUBLISHED, tmp_path / "published")
    path = tmp_path / "published" / "table2.json"
    table = json.loads(path.read_text())
    table["dataset"]["positives"]["push"] += 1_000
    path.write_text(json.dumps(table))
    assert "sum to 119,870" in compare(OURS).remarks[0]
    path.write_text("{}")
    with pytest.raises(IntegrityError, match="cannot be read"):
        published_counts()


def test_shares_are_explained_by_who_collected() -> None:
    assert not any("who collected" in remark for remark in compare(OURS).remarks)  # the random policy alone
    later = dataclasses.replace(row("grasp", 0, 50, 45), round=2, policy="tae")
    remark = compare(dataclasses.replace(OURS, steps=(*OURS.steps, later))).remarks[-1]
    assert "random policy played succeed in grasp 29.2 %, grasp_push 11.1 %, grasp_grasp_push 28.6 %" in remark
    assert remark.endswith("those of round 2, by other policies, in grasp 90.0 %.")
