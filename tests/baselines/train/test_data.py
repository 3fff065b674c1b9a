"""What reaches the network: the right steps, balanced, with label and maps together, and nothing that is tested."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import rema_data
from baselines.train.config import TrainingConfig
from baselines.train.data import open_data, prepared
from evaluator.scenarios import load_list
from rema_data.augment import Augment
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.loader.batch import StepBatch
from rema_data.release.seal import Description, seal
from rema_data.schema import Episode, Situation
from rema_data.store.block import BlockKey, BlockWriter, encode_episodes
from rema_data.testing import FINGERPRINT, make_block, make_release, synthetic_episode


def test_tool_picks_are_grasps(release: rema_data.Release, config: TrainingConfig) -> None:
    data = open_data(release, config)
    table = data.train.table
    assert set(table["primitive"]) == {"grasp"} and set(table["task"]) == {"grasp", "grasp_push"}
    assert set(table["split"]) == {"train"} and set(data.validation.table["split"]) == {"val"}


def test_a_condition_chooses_steps_of_both_splits(release: rema_data.Release, config: TrainingConfig) -> None:
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    data = open_data(release, replace(config, where="task = 'grasp_push'"))
    assert set(data.train.table["task"]) == set(data.validation.table["task"]) == {"grasp_push"}
    assert data.train.fingerprint != open_data(release, config).train.fingerprint


def test_batches_are_balanced(release: rema_data.Release, config: TrainingConfig) -> None:
    for batch in islice(open_data(release, config).batches(), 30):
        assert batch.success.sum() == len(batch) // 2


def test_a_skill_has_the_share_that_it_is_given(release: rema_data.Release) -> None:
    config = TrainingConfig("push", ("push", "grasp_push"), shares={"grasp_push": 3})
    data = open_data(release, config)
    for batch in islice(data.batches(), 10):
        rows = data.train.table.iloc[batch.index.numpy()]
        assert (rows["skill"] == "grasp_push").sum() == 6 and rows["success"].sum() == 4


def test_validation_has_both_labels_in_equal_numbers_where_it_can(release: rema_data.Release) -> None:
    config = TrainingConfig("grasp", ("grasp", "grasp_push"), validation_steps=4)
    chosen = open_data(release, config).validation
    assert chosen.table["success"].sum() == 2 and len(chosen) == 4


def test_pixel_and_maps_stay_together(release: rema_data.Release, config: TrainingConfig) -> None:
    """Without augmentation the sample is the stored step, its end effector turned to the action's angle."""
    data = open_data(release, config)
    batch = data.train[np.arange(6)]
    assert isinstance(batch, StepBatch)
    samples = prepared(batch, None, torch.Generator(), torch.device("cpu"))
    cell, k = batch.action // 16, batch.action % 16
    assert torch.equal(samples.pixel, cell) and torch.equal(samples.scene, batch.float().scene)
    straight = k == 0
    assert torch.allclose(samples.end_effector[straight], batch.float().end_effector[straight], atol=1e-6)
    quarter = torch.rot90(batch.float().end_effector, -1, (2, 3))
    turned = prepared(batch.replace(action=batch.action - k + 4), None, torch.Generator(), torch.device("cpu"))
    assert torch.allclose(turned.end_effector, quarter, atol=1e-5)


def test_translation_moves_the_label_with_the_scene(release: rema_data.Release, config: TrainingConfig) -> None:
    """What lies under the labelled pixel is what lay there before."""
    data = open_data(release, config)
    batch = data.train[np.arange(20)]
    assert isinstance(batch, StepBatch)
    augment = Augment(data.train, rotate=False, mirror=False)
    plain, moved = (
        prepared(batch, chosen, torch.Generator().manual_seed(0), torch.device("cpu")) for chosen in (None, augment)
    )
    under = [samples.scene.flatten(1).gather(1, samples.pixel[:, None]) for samples in (plain, moved)]
    assert torch.equal(*under) and not torch.equal(plain.pixel, moved.pixel)
    assert torch.equal(plain.end_effector, moved.end_effector)


def test_a_skill_without_a_success(tmp_path: Path) -> None:
    made = make_release(tmp_path, tasks=("grasp",), episodes=6, success=0.0)
    release = rema_data.Release(made, cache="memory")
    for on_empty in ("raise", "renormalise"):  # a single label is of no use either way
        with pytest.raises(InputError, match="no success") as caught:
            open_data(release, TrainingConfig("grasp", ("grasp",), on_empty=on_empty))  # type: ignore[arg-type]
        assert "collect more" in caught.value.hint


def test_one_skill_of_two_without_a_success(tmp_path: Path) -> None:
    """It is named; with ``renormalise`` the other one is trained on."""
    keys = [BlockKey(1, task, split) for task in ("push", "grasp_push") for split in ("train", "val")]
    for key in keys:
        make_block(tmp_path / "staging" / key.path, key, 20, 0, 0.5 if key.task == "push" else 0.0)
    about = Description("half", "Half", "Synthetic.", "CC-BY-4.0", "The rema authors")
    made = seal(tmp_path / "staging", tmp_path, about, keys, fingerprint=FINGERPRINT)
    release = rema_data.Release(made, cache="memory")
    with pytest.raises(InputError, match="no success of the skill grasp_push"):
        open_data(release, TrainingConfig("push", ("push", "grasp_push")))
    data = open_data(release, TrainingConfig("push", ("push", "grasp_push"), on_empty="renormalise"))
    assert len(next(iter(data.sampler))) == 8


def test_a_validation_split_without_a_success(tmp_path: Path) -> None:
    """Nothing tells good weights from bad ones: they are not chosen by it without a word."""
    keys = [BlockKey(1, "push", split) for split in ("train", "val")]
    for key in keys:
        make_block(tmp_path / "staging" / key.path, key, 20, 0, 0.5 if key.split == "train" else 0.0)
    about = Description("half", "Half", "Synthetic.", "CC-BY-4.0", "The rema authors")
    release = rema_data.Release(seal(tmp_path / "staging", tmp_path, about, keys, fingerprint=FINGERPRINT), "memory")
    with pytest.raises(InputError, match="no success to validate with"):
        open_data(release, TrainingConfig("push", ("push",)))
    assert len(open_data(release, TrainingConfig("push", ("push",), on_empty="renormalise")).validation) == 20


@pytest.mark.parametrize("content", [None, b"PAR1"])
def test_training_needs_readable_scenario_lists(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: Any
) -> None:
    (tmp_path / "scenarios" / "v1").mkdir(parents=True)
    if content is not None:
        (tmp_path / "scenarios" / "v1" / "push_test.parquet").write_bytes(content)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path))
    with pytest.raises((MissingFileError, IntegrityError), match="no scenario lists|push_test.parquet cannot be read"):
        open_data(release, config)


def test_test_scenarios_are_never_trained_on(tmp_path: Path) -> None:
    """One scene of the frozen test list, hidden in a training block."""
    key = BlockKey(1, "grasp", "train")
    episodes = [synthetic_episode(key, n) for n in range(8)]
    (step,) = episodes[5].steps
    tested = load_list("grasp", "test").scenarios[17].placements[0]
    step = type(step)(Situation("grasp", 0, tested), step.observation, step.action, step.outcome, "random", "1" * 64)
    episodes[5] = Episode("grasp", 1, "train", 5, 0, (step,))
    staging = tmp_path / "staging"
    for split in ("train", "val"):
        own = key._replace(split=split)
        writer = BlockWriter(staging / own.path)
        writer.append(*encode_episodes(episodes if split == "train" else [synthetic_episode(own, n) for n in range(4)]))
        writer.close()
    about = Description("leaky", "Leaky", "For tests.", "CC-BY-4.0", "Nobody")
    made = seal(staging, tmp_path, about, [key, key._replace(split="val")], fingerprint=FINGERPRINT)
    with pytest.raises(
        IntegrityError, match="step 5 of round-1/grasp/train in leaky is the scenario v1/grasp/test/00017"
    ):
        open_data(rema_data.Release(made, cache="memory"), TrainingConfig("grasp", ("grasp",)))
