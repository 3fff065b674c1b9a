"""The files of a LeRobot dataset, without LeRobot; what its own reader sees: benchmarks/lerobot_reader.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rema_data.convert import ExportOptions, export_release
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import Step
from rema_data.store.block import BlockKey
from rema_data.testing import synthetic_episode

TASK = "grasp_grasp_push"
COUNTS = {"train": 10, "val": 2}


@pytest.fixture(scope="module")
def dataset(release: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lerobot")
    export_release(release, folder, "lerobot", tasks=[TASK])
    return folder / TASK


def steps() -> list[Step]:
    keys = [(BlockKey(1, TASK, split), n) for split, count in COUNTS.items() for n in range(count)]
    return [step for key, n in keys for step in synthetic_episode(key, n).steps]


def frames(dataset: Path) -> pd.DataFrame:
    return pd.concat([pd.read_parquet(path) for path in sorted(dataset.glob("data/*/*.parquet"))], ignore_index=True)


def test_a_frame_is_a_step(dataset: Path) -> None:
    found = frames(dataset)
    assert found["index"].tolist() == list(range(len(steps())))
    for (_, row), step in zip(found.iterrows(), steps(), strict=True):
        assert np.array_equal(np.stack(row["observation.scene"][0]), step.observation.scene_m())
        planes = np.array([np.stack(plane) for plane in row["observation.end_effector"]])
        assert np.array_equal(np.moveaxis(planes, 0, -1), step.observation.end_effector())
        assert row["grid_index"] == step.action.index
        assert row["frame_index"] == row["timestamp"] == step.situation.step
        assert row["next.success"] == row["next.reward"] == (step.situation.last and step.outcome.success)
        assert row["next.done"] == (step.situation.last or not step.outcome.success)
        assert row["failure"] == (step.outcome.failure or "")


def test_the_description_fits_the_frames(dataset: Path) -> None:
    info = json.loads((dataset / "meta/info.json").read_text())
    found = frames(dataset)
    assert info["codebase_version"] == "v3.0"
    assert set(info["features"]) == set(found.columns)
    assert (info["total_frames"], info["total_episodes"], info["total_tasks"]) == (len(found), 12, 1)
    assert info["splits"] == {"train": "0:10", "val": "10:12"}
    episodes = pd.read_parquet(dataset / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["split"].tolist() == ["train"] * 10 + ["val"] * 2
    for row in episodes.to_dict("records"):
        own = found[found["episode_index"] == row["episode_index"]]
        assert (own["index"].min(), own["index"].max() + 1) == (row["dataset_from_index"], row["dataset_to_index"])
        path = info["data_path"].format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        assert row["episode_index"] in pq.read_table(dataset / path)["episode_index"].to_pylist()
        assert row["stats/grid_index/max"].tolist() == [own["grid_index"].max()]
    tasks = pd.read_parquet(dataset / "meta/tasks.parquet")
    assert tasks["task_index"].tolist() == [0] and "stick" in tasks.index[0]
    assert episodes["tasks"].map(list).tolist() == [[tasks.index[0]]] * 12


@pytest.mark.parametrize("maps", ["metres", "quantised"])
def test_the_statistics_are_those_of_all_frames(maps: Any, release: ReleaseFolder, tmp_path: Path) -> None:
    export_release(release, tmp_path, "lerobot", ExportOptions(maps), tasks=[TASK])
    stats = json.loads((tmp_path / TASK / "meta/stats.json").read_text())
    found = pa.concat_tables(pq.read_table(path) for path in sorted((tmp_path / TASK).glob("data/*/*.parquet")))
    for name in stats:
        values = np.array(found[name].to_pylist(), np.float64)
        axes = (0, 2, 3) if values.ndim == 4 else 0
        quantiles = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
        wanted = {
            "min": values.min(axes),
            "max": values.max(axes),
            "mean": values.mean(axes),
            "std": values.std(axes),
            **{key: np.quantile(values, share, axes) for key, share in quantiles.items()},
        }
        assert stats[name].pop("count") == [len(found)]
        assert stats[name].keys() == wanted.keys()
        for key, value in wanted.items():
            assert np.allclose(np.ravel(stats[name][key]), np.ravel(value), rtol=1e-9, atol=1e-9), (name, key)
