"""The benchmarks of killed runs and recursions run, in a reduced size."""

from __future__ import annotations

from pathlib import Path

import pytest

from baselines.rounds.recursion_plan import load_recursion
from benchmarks import kills_rounds

from .test_benchmarks import measured


@pytest.mark.benchmark
def test_a_killed_evaluator_leaves_the_same_bytes(tmp_path: Path) -> None:
    words = ("--kills", "1", "--episodes", "40", "--batch-size", "4")
    numbers = measured(tmp_path, "kills", *words)["numbers"]
    (kill,) = numbers["kills"]
    assert kill["victim"] == "evaluator" and kill["same"] and kill["starts"] > 1
    assert numbers["reference"] == {"asked": 70, "simulated": 70}  # 40, and 30 of the audit


def test_the_killed_recursion_is_the_papers_at_a_share_of_its_size(tmp_path: Path) -> None:
    """All rounds and the networks that play them; the small networks of the last round are the joint ones."""
    (path := tmp_path / "plan.toml").write_text(kills_rounds.scaled(kills_rounds.PLAN.read_text(), 1, 30))
    plan, whole = load_recursion(path), load_recursion(kills_rounds.PLAN)
    assert plan.name == kills_rounds.NAME and not plan.policies
    for small, entry in zip(plan.rounds, whole.rounds, strict=True):
        assert small.collection is not None and entry.collection is not None
        assert small.collection["episodes"] == {"train": 100, "val": 20}
        assert small.collection["tasks"] == entry.collection["tasks"]
        assert small.played_by == tuple(place.replace("rema-v1", plan.name) for place in entry.played_by)
        assert {one.name for one in small.networks} == {one.name for one in entry.networks if one.folder != "separate"}
        assert all(one.config.architecture.width == 8 and one.config.updates == 30 for one in small.networks)


@pytest.mark.slow
def test_a_killed_recursion_leaves_the_same_bytes(tmp_path: Path) -> None:
    numbers = measured(tmp_path, "kills_rounds", "--kills", "2", "--percent", "0.5", "--updates", "2")["numbers"]
    assert len(numbers["kills"]) == 2 == sum(one["kills"] for one in numbers["runs"])
    assert {row["killed"] for row in numbers["kills"]} == {"the process", "its group"}
    assert all(not one["different"] and not one["left"] for one in numbers["runs"]) and numbers["files"] > 20
