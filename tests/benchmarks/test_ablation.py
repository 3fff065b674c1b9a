"""What the ablation changes is what it says that it changes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rema_data
from baselines.tae.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from baselines.tae.network import Architecture, TaeNetwork
from baselines.tae_policy import TaePolicy
from baselines.train.command import train
from benchmarks import ablation
from benchmarks.policies.displaced import Policy
from benchmarks.results import RESULTS, ROOT
from rema_data import grid
from rema_data.testing import make_release
from tests.evaluator.policy.batches import make_batch


def test_every_way_of_training_is_accepted_and_differs_from_the_plan_where_it_says_so() -> None:
    def asked(way: ablation.Way) -> dict[str, Any]:
        words = [*ablation.training_command(way, "cpu"), "--output", "nowhere"]
        assert words[:2] == ["rema", "train"]
        return train.make_context("train", words[2:]).params

    planned = asked(ablation.WAYS[ablation.PLANNED])
    config = ablation.NETWORK.config
    for name in ("primitive", "updates", "validate_every", "learning_rate", "schedule", "rotate", "seed", "balance"):
        assert planned[name] == getattr(config, name)
    for way in ablation.WAYS.values():
        changed = {name for name, value in asked(way).items() if value != planned[name]}
        assert len(changed) == sum(word.startswith("--") for word in way.options), way


def test_the_network_of_the_release_came_out_again() -> None:
    """As docs/baselines.md says of the one that was trained as planned, on a CPU."""
    measured = json.loads((RESULTS / "ablation_cpu.json").read_text(encoding="utf-8"))["numbers"]
    network = ROOT / "releases" / "checkpoints" / ablation.PLAN.stem / ablation.NETWORK.folder / ablation.NETWORK.name
    if not network.with_suffix(".json").is_file():
        pytest.skip("a copy without the networks")
    assert measured["as planned"]["card"]["sha256"] == load_checkpoint(network)[1].sha256


def test_labels_are_turned_round_in_a_share_of_the_training_split(tmp_path: Path) -> None:
    made = make_release(tmp_path, tasks=("grasp",), episodes=400)
    cache = rema_data.Release(made, cache="memory").cache
    true, trained_on = cache.index, cache.index["split"] == cache.categories["split"].index("train")
    once, again = (
        ablation.mislabelled(rema_data.Release(made, cache="memory"), 0.1).cache.index.copy() for _ in range(2)
    )
    wrong = true["success"] != once["success"]
    assert 0.05 < wrong[trained_on].mean() < 0.15 and not wrong[~trained_on].any() and len(wrong) > sum(trained_on)
    assert np.array_equal(once, again)
    assert set(true["success"][wrong]) == {True, False}
    once["success"] = true["success"]
    assert np.array_equal(once, true)


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    small = Architecture(width=4)
    save_checkpoint(
        tmp_path, "push", TaeNetwork(small).state_dict(), Checkpoint("push", ("push",), small, "tiny", "0" * 64)
    )
    return tmp_path


def test_the_hand_arrives_within_a_pixel_and_where_it_may(checkpoint: Path) -> None:
    batch = make_batch(40, primitive="push")
    meant, answered = TaePolicy(checkpoint).act(batch), Policy(checkpoint).act(batch)
    (i, j, k), (row, column, angle) = grid.decode(meant), grid.decode(answered)
    assert np.abs(row - i).max() <= 1 and np.abs(column - j).max() <= 1 and np.array_equal(k, angle)
    assert len(set(zip(row - i, column - j, strict=True))) > 4
    assert batch.valid[np.arange(40), row, column, angle].all()
    assert [int(Policy(checkpoint).act(batch.one(n))[0]) for n in range(40)] == answered.tolist()
