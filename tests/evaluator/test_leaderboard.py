"""Rows of the leaderboard."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from evaluator.leaderboard import leaderboard, published_rows, read_run, remarks

from .cli.conftest import write_run  # noqa: F401 - a fixture

WriteRun = Callable[..., Path]


def test_the_published_rows_are_the_papers() -> None:
    rates = {(row.policy, row.task): row.rate for row in published_rows()}
    assert len(rates) == 16
    assert rates["scripted", "push"] == pytest.approx(0.9987)
    assert rates["random", "grasp_grasp"] == pytest.approx(0.0177)
    assert rates["joint", "grasp_push"] == pytest.approx(0.4549)
    intervals = {(row.policy, row.task): row.ci95 for row in published_rows()}
    assert intervals["joint", "grasp"] == pytest.approx((0.9303, 0.9400), abs=1e-4)  # as the paper's counts would give


@pytest.mark.parametrize(
    ("changes", "tag"),
    [
        ({}, "random"),
        ({"policy": "scripted", "privileged": True}, "privileged"),
        ({"policy": "cheat", "privileged": True}, "privileged"),
        ({"policy": "joint"}, "submitted"),
        ({"policy": "random.py"}, "submitted"),
        ({"policy": "tae-joint"}, "learned"),
        ({"policy": "tae-joint.py"}, "submitted"),
    ],
)
def test_tags(write_run: WriteRun, changes: dict[str, object], tag: str) -> None:  # noqa: F811
    row = read_run(write_run("a", **changes))
    assert row.tag == tag
    assert (row.z is None) == (row.policy not in ("random", "scripted"))


def test_an_end_to_end_run_has_no_published_rate(write_run: WriteRun) -> None:  # noqa: F811
    assert read_run(write_run("a", protocol="end-to-end")).z is None


def test_runs_that_do_not_compare_are_named(write_run: WriteRun) -> None:  # noqa: F811
    runs = [write_run("a"), write_run("b", policy="my_policy", scenarios_hash="other")]
    assert any("do not compare" in remark for remark in remarks(leaderboard(runs)))
    assert not any("do not compare" in remark for remark in remarks(leaderboard(runs[:1])))


def test_a_run_without_an_eligible_episode_has_no_rate(write_run: WriteRun) -> None:  # noqa: F811
    row = read_run(write_run("a", eligible=0, successes=0, infra_errors=3))
    assert row.rate is None and row.ci95 is None
    assert any("Infrastructure" in remark for remark in remarks([row]))
