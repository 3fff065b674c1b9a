"""The benchmarks of training and inference run, in a reduced size, and compare what they say they compare."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

from baselines.rounds.recursion_plan import load_recursion
from baselines.tae.checkpoint import Checkpoint, save_checkpoint
from baselines.tae.correlation import cross_convolve
from baselines.tae.network import Architecture, TaeNetwork
from evaluator.policy.shipped import Shipped
from tests.benchmarks.test_benchmarks import ROOT, measured, run

sys.path.insert(0, str(ROOT))
from benchmarks import baseline_tables
from benchmarks.train import looped


def test_the_straightforward_way_computes_the_same() -> None:
    features, kernels = torch.rand(3, 2, 16, 16), torch.rand(3, 2, 28, 28)
    torch.testing.assert_close(looped(features, kernels), cross_convolve(features, kernels))


@pytest.mark.benchmark
def test_training(tmp_path: Path) -> None:
    words = ("--release", "rema-sample", "--updates", "1", "--repeats", "1", "--primitives", "push")
    (found,) = measured(tmp_path, "train", *words, REMA_HOME=str(tmp_path / "home"))["numbers"]["found"]
    assert set(found["speeds"]) == {"ours", "straightforward"} and found["ratio"] > 0
    assert 0 < found["waits"]["ours"][0] < 1


@pytest.mark.benchmark
def test_inference(tmp_path: Path) -> None:
    small = Architecture(width=8)
    for name in ("grasp", "push"):
        about = Checkpoint(name, (name,), small, "tiny", "0" * 64)
        save_checkpoint(tmp_path / "networks", name, TaeNetwork(small).state_dict(), about)
    words = ("--checkpoint", str(tmp_path / "networks"), "--tasks", "grasp_grasp", "--scenarios", "16")
    rows = measured(tmp_path, "infer", *words, "--repeats", "1")["numbers"]["found"]
    assert [row["task"] for row in rows] == ["grasp_grasp"]
    for row in rows:
        assert set(row["speeds"]) == {"plain", *row["ways"]}
        compared = [way["plain"] for way in row["ways"].values()] + [row["ways"]["ours"]["float32"]]
        for counts in compared:
            assert counts["equal"] + len(counts["others"]) == counts["of"] == 16
            assert counts["equal"] >= 15  # rounding may decide a tie


def test_the_page_of_the_baselines_is_made_from_what_is_committed(tmp_path: Path) -> None:
    """By the command that it names."""
    pytest.importorskip("matplotlib")
    committed = (ROOT / "docs" / "baselines.md").read_text()
    words = committed.partition("`python benchmarks/baselines.py")[2].partition("`")[0].split()
    done = run("baselines", *words, "--page", str(tmp_path / "baselines.md"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "baselines.md").read_text() == committed
    assert (tmp_path / "images" / "success_by_round.png").read_bytes().startswith(b"\x89PNG")


def test_a_page_shows_the_runs_of_its_plan_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of other networks that shipped under the same name are not shown for those of the plan."""
    plans = {name: load_recursion(ROOT / "manifests" / "plans" / f"{name}.toml") for name in ("rema-v0", "rema-v1")}
    policies = {
        "random-grasp-conditional": "random",
        "tae-joint-grasp-conditional": "tae-joint",
        "rema-v0-joint-grasp-conditional": "tae-joint",
        "rema-v0-round-1-grasp-conditional": "tae",
        "rema-v1-round-1-grasp-conditional": "tae",
        "round-1-grasp-conditional": "tae",
    }
    runs = {name: {"policy": policy, "from": name} for name, policy in policies.items()}
    monkeypatch.setattr(baseline_tables, "shipped_policies", lambda: {"tae-joint": Shipped("rema-v1/joint", {})})
    for name, plan in plans.items():
        found = {own: run["from"] for own, run in baseline_tables.of_plan(runs, plan).items()}
        joint = "rema-v0-joint-grasp-conditional" if name == "rema-v0" else "tae-joint-grasp-conditional"
        assert found == {
            "random-grasp-conditional": "random-grasp-conditional",
            "round-1-grasp-conditional": f"{name}-round-1-grasp-conditional",
            "tae-joint-grasp-conditional": joint,
        }


def test_the_page_of_the_newest_release_needs_no_runs(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    done = run("baselines", "--page", str(tmp_path / "baselines.md"))
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "baselines.md").read_text()
    assert "The baselines of rema-v1." in text and "--output runs/rema-v1-round-N-TASK-conditional" in text
    assert "| joint/push | rema-v1 | 3,000 x 8 |" in text and "projection" not in text
