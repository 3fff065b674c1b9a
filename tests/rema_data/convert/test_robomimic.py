"""robomimic's own dataset reads an export. Skipped where robomimic is not installed; it is no dependency of rema."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from rema_data.convert import ExportOptions, export_release
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import Step
from rema_data.store.block import BlockKey
from rema_data.testing import synthetic_episode

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    dataset = pytest.importorskip("robomimic.utils.dataset")

pytestmark = pytest.mark.filterwarnings("ignore")
TASK = "grasp_grasp_push"
KEYS = ["actions", "rewards", "dones", "grid_index"]
OBS = ["scene", "end_effector"]


def sequence_dataset(path: Path, **options: Any) -> Any:
    plain = {"load_next_obs": False, "hdf5_use_swmr": True} | options
    return dataset.SequenceDataset(str(path), OBS, KEYS, **plain)


def steps(split: str) -> list[Step]:
    count = {"train": 10, "val": 2}[split]
    key = BlockKey(1, TASK, split)
    return [step for n in range(count) for step in synthetic_episode(key, n).steps]


@pytest.mark.parametrize("split", ["train", "val"])
@pytest.mark.parametrize("cache", [None, "all"])
def test_every_step_of_a_filter_key_is_the_one_that_was_recorded(split: str, cache: str | None, exported: Path) -> None:
    demos = sequence_dataset(exported / f"{TASK}.hdf5", filter_by_attribute=split, hdf5_cache_mode=cache)
    assert len(demos) == len(steps(split))
    for row, step in enumerate(steps(split)):
        item = demos[row]
        assert np.array_equal(item["obs"]["scene"][0, ..., 0], step.observation.scene_m())
        assert np.array_equal(item["obs"]["end_effector"][0], step.observation.end_effector())
        assert item["grid_index"][0] == step.action.index
        assert item["rewards"][0] == (step.situation.last and step.outcome.success)
        assert item["dones"][0] == (step.situation.last or not step.outcome.success)


@pytest.mark.parametrize("workers", [0, 2])
def test_batches_come_through_a_data_loader(workers: int, exported: Path) -> None:
    demos = sequence_dataset(exported / f"{TASK}.hdf5", filter_by_attribute="train")
    loader = torch.utils.data.DataLoader(demos, batch_size=4, num_workers=workers)
    batches = list(loader)
    assert sum(len(batch["actions"]) for batch in batches) == len(steps("train"))
    assert batches[0]["actions"].shape == (4, 1, 4)
    assert batches[0]["obs"]["end_effector"].shape == (4, 1, 112, 112, 4)


def test_whole_episodes_and_next_observations(release: ReleaseFolder, tmp_path: Path) -> None:
    (made,) = export_release(release, tmp_path, options=ExportOptions(next_obs=True), tasks=[TASK])
    demos = sequence_dataset(made.path, filter_by_attribute="train", load_next_obs=True, seq_length=4)
    for number in range(10):
        recorded = synthetic_episode(BlockKey(1, TASK, "train"), number).steps
        found = demos.get_trajectory_at_index(number)
        assert found["ep"] == f"demo_{number}"
        assert found["grid_index"].tolist() == [step.action.index for step in recorded]
        following = [*recorded[1:], recorded[-1]]
        for row, step in enumerate(following):
            assert np.array_equal(found["next_obs"]["scene"][row, ..., 0], step.observation.scene_m())
