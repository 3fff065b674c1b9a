"""What robomimic reads of an export, and files that are whole or not there."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from rema_data.convert import ExportOptions, export_release
from rema_data.errors import InputError, MissingFileError, RunMismatchError, StorageError
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import Episode
from rema_data.store.block import BlockKey
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS
from rema_data.testing import synthetic_episode
from tests.rema_data.convert.conftest import files

TASK = "grasp_grasp_push"


def episodes(task: str) -> list[Episode]:
    """What the release holds of a task, in the order of the demos."""
    counts = {"train": 10, "val": 2}
    return [synthetic_episode(BlockKey(1, task, split), n) for split, count in counts.items() for n in range(count)]


def names(file: h5py.File, key: str) -> list[str]:
    """As robomimic reads a filter key."""
    return [name.decode("utf-8") for name in np.array(file[f"mask/{key}"][:])]


@pytest.mark.parametrize("task", ["grasp", TASK])
def test_the_layout_is_the_one_that_robomimic_reads(task: str, exported: Path) -> None:
    with h5py.File(exported / f"{task}.hdf5", "r", swmr=True, libver="latest") as file:
        data = file["data"]
        demos = sorted(data, key=lambda name: int(name[5:]))
        assert demos == [f"demo_{n}" for n in range(12)]
        assert data.attrs["total"] == sum(len(episode.steps) for episode in episodes(task))
        environment = json.loads(data.attrs["env_args"])
        assert {"env_name", "type", "env_kwargs"} <= set(environment)
        for name, episode in zip(demos, episodes(task), strict=True):
            demo, count = data[name], len(episode.steps)
            assert demo.attrs["num_samples"] == count
            assert demo["actions"].shape == (count, 4) and demo["actions"].dtype == np.float32
            assert demo["rewards"][()].tolist() == [0] * (count - 1) + [episode.success]
            assert demo["dones"][()].tolist() == [0] * (count - 1) + [1]
            assert demo["grid_index"][()].tolist() == [step.action.index for step in episode.steps]
            for row, step in enumerate(episode.steps):
                assert np.array_equal(demo["obs/scene"][row], step.observation.scene_m()[..., None])
                assert np.array_equal(demo["obs/end_effector"][row], step.observation.end_effector())


def test_filter_keys_name_splits_rounds_and_successes(exported: Path) -> None:
    with h5py.File(exported / f"{TASK}.hdf5") as file:
        assert names(file, "train") == names(file, "round_1_train") == [f"demo_{n}" for n in range(10)]
        assert names(file, "val") == names(file, "valid") == names(file, "round_1_val") == ["demo_10", "demo_11"]
        assert names(file, "round_1") == names(file, "train") + names(file, "val")
        won = [f"demo_{n}" for n, episode in enumerate(episodes(TASK)) if episode.success]
        assert won and names(file, "success") == won
        assert names(file, "train_success") == [name for name in won if name in names(file, "train")]


def test_every_column_is_there_with_its_unit(exported: Path) -> None:
    with h5py.File(exported / f"{TASK}.hdf5") as file:
        for demo, episode in zip((file[f"data/demo_{n}"] for n in range(12)), episodes(TASK), strict=True):
            found = dict(demo.attrs)
            nulls = {"variation"} | ({"failure", "failed_step"} if episode.success else set())
            assert set(found) == {column.name for column in EPISODE_COLUMNS} - nulls | {"num_samples"}
            assert (found["task"], found["split"], found["episode"]) == (TASK, episode.split, episode.index)
            assert found.get("failure") == episode.failure
        columns = file[f"rema/round-1/{TASK}/train"]
        assert set(columns) == {column.name for column in STEP_COLUMNS}
        assert columns["tool0_x_m"].attrs["unit"] == "m" and columns["tool0_x_m"].attrs["frame"] == "hand"
        pinched = [step.situation.pinch for episode in episodes(TASK)[:10] for step in episode.steps]
        assert np.isnan(columns["pinch_x_m"][()]).tolist() == [pinch is None for pinch in pinched]


def test_quantised_maps_are_the_stored_values(quantised: Path, exported: Path) -> None:
    with h5py.File(quantised / f"{TASK}.hdf5") as stored, h5py.File(exported / f"{TASK}.hdf5") as metres:
        scale = stored["rema"].attrs
        for name in stored["data"]:
            obs = stored[f"data/{name}/obs"]
            height = obs["scene"][()] * scale["quantised_step_m"] + scale["quantised_offset_m"]
            assert obs["scene"].dtype == obs["end_effector"].dtype == np.uint16
            assert np.allclose(height, metres[f"data/{name}/obs/scene"], rtol=0, atol=1e-6)
            masks = metres[f"data/{name}/obs/end_effector"][..., 1::2]
            assert np.array_equal(obs["end_effector"][..., 1::2], masks)


def test_next_obs_is_what_is_seen_one_step_later(release: ReleaseFolder, tmp_path: Path) -> None:
    (made,) = export_release(release, tmp_path, options=ExportOptions(next_obs=True), tasks=[TASK], split="val")
    with h5py.File(made.path) as file:
        for demo in file["data"].values():
            for name, obs in demo["obs"].items():
                following = demo[f"next_obs/{name}"]
                assert np.array_equal(following[:-1], obs[1:])
                assert np.array_equal(following[-1], obs[-1])


def test_equal_exports_are_equal_bytes_and_are_not_written_twice(
    release: ReleaseFolder, exported: Path, tmp_path: Path
) -> None:
    made = export_release(release, tmp_path, tasks=["grasp"])
    assert files(tmp_path) == {"grasp.hdf5": (exported / "grasp.hdf5").read_bytes()}
    assert [(file.episodes, file.steps, file.new) for file in made] == [(12, 12, True)]
    assert made[0].bytes == made[0].path.stat().st_size
    before = made[0].path.stat().st_mtime_ns
    again = export_release(release, tmp_path)
    assert [(file.path.name, file.new) for file in again] == [("grasp.hdf5", False), (f"{TASK}.hdf5", True)]
    assert made[0].path.stat().st_mtime_ns == before


@pytest.mark.parametrize("options", [ExportOptions("quantised"), ExportOptions(next_obs=True)])
def test_another_export_is_not_overwritten(options: ExportOptions, release: ReleaseFolder, export: Path) -> None:
    before = files(export)
    with pytest.raises(RunMismatchError, match="another export") as error:
        export_release(release, export, options=options)
    assert "another folder" in error.value.hint
    with pytest.raises(RunMismatchError, match="another export"):
        export_release(release, export, split="val")
    assert files(export) == before


def test_what_is_not_there_cannot_be_exported(release: ReleaseFolder, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no task push"):
        export_release(release, tmp_path, tasks=["push"])
    with pytest.raises(MissingFileError, match="not whole on this machine") as missing:
        export_release(ReleaseFolder(release.manifest, tmp_path / "empty"), tmp_path)
    assert "copy them again" in missing.value.hint
    assert files(tmp_path) == {}


def test_a_folder_that_cannot_be_made_is_an_error(release: ReleaseFolder, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"cannot write .*file/grasp\.hdf5"):
        export_release(release, tmp_path / "file")
