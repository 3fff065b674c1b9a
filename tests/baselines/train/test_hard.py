"""Hard failures: those that the weights score highest, in the places of failures of their skill, and nowhere else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import rema_data
from baselines.tae.network import Architecture, TaeNetwork
from baselines.train.config import TrainingConfig
from baselines.train.data import open_data
from baselines.train.hard import HardFailures
from baselines.train.loop import train
from baselines.train.validation import log_odds
from tests.baselines.train.conftest import tree
from tests.baselines.train.test_loop import Interruption, interrupted_at

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.train.data.refuse_test_scenes", lambda *_: None)


@pytest.fixture(scope="module")
def both() -> TrainingConfig:
    """Two skills, and so many candidates that every failure is one."""
    return TrainingConfig("push", ("push", "grasp_push"), hard_share=0.5, hard_every=10, architecture=Architecture(4))


def test_failures_that_score_highest_take_the_places_of_others(
    release: rema_data.Release, both: TrainingConfig
) -> None:
    data, network = open_data(release, both), TaeNetwork(Architecture(width=4)).train()
    hard = HardFailures(data.train, both)
    drawn = [rows for _ in range(3) for rows in data.sampler][:10]
    assert [hard.replaced(rows) for rows in drawn] == [list(rows) for rows in drawn]  # nobody has looked yet
    hard.look(network, CPU)
    assert network.training
    table, scores = data.train.table, log_odds(network, data.train, CPU)
    kept = [hard.replaced(rows) for rows in drawn]
    for name in ("push", "grasp_push"):
        failed = np.flatnonzero((table["skill"] == name) & ~table["success"])
        pairs = [(a, b) for before, after in zip(drawn, kept, strict=True) for a, b in zip(before, after, strict=True)]
        own = [(a, b) for a, b in pairs if a in failed]
        assert all(b in failed for _, b in own)
        put = [b for a, b in own[1::2]]  # every second one
        assert all(a == b for a, b in own[::2])
        # candidates beyond the number of failures come up again: a quarter of the draws is the top quarter of the rows
        assert put and scores[put].min() >= np.quantile(scores[failed], 0.7)
    won = table["success"].to_numpy()
    assert all((won[before] == won[after]).all() for before, after in zip(drawn, kept, strict=True))


def test_every_look_has_other_candidates_and_a_state_goes_on(release: rema_data.Release, both: TrainingConfig) -> None:
    few = replace(both, hard_every=1)  # eight candidates
    data, network = open_data(release, few), TaeNetwork(Architecture(width=4))
    hard, again = HardFailures(data.train, few), HardFailures(data.train, few)
    hard.look(network, CPU)
    first = hard.state_dict()["hard"]
    hard.replaced(next(iter(data.sampler)))
    again.load_state_dict(json.loads(json.dumps(hard.state_dict())))
    for one in (hard, again):
        one.look(network, CPU)
    assert hard.state_dict() == again.state_dict() and hard.state_dict()["hard"] != first


@pytest.mark.parametrize("at", [3, 7])
def test_interrupted_and_resumed_to_the_same_weights(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path, at: int
) -> None:
    config = replace(config, hard_share=0.5, hard_every=2, precision="bfloat16")
    train(release, config, tmp_path / "whole", "grasp")
    with pytest.raises(Interruption):
        train(release, config, tmp_path / "killed", "grasp", progress=interrupted_at(at), save_every=1)
    done = train(release, config, tmp_path / "killed", "grasp")
    assert tree(tmp_path / "killed") == tree(tmp_path / "whole")
    assert (done.checkpoint.training["hard_share"], done.checkpoint.training["hard_every"]) == (0.5, 2)
    plain = train(release, replace(config, hard_share=0.0), tmp_path / "plain", "grasp")
    assert plain.checkpoint.sha256 != done.checkpoint.sha256
