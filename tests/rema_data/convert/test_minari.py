"""A Minari dataset and its environment; Minari's own reader: benchmarks/minari_reader.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from rema_data.convert import ExportOptions, export_release
from rema_data.convert.minari_writer import environment
from rema_data.errors import InputError
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import TASKS
from rema_data.store.block import BlockKey
from rema_data.testing import synthetic_episode

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed: the extra `gym`")

TASK = "grasp_grasp_push"


@pytest.fixture(scope="module")
def dataset(release: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("minari")
    export_release(release, folder, "minari", tasks=[TASK])
    return folder / f"{TASK}-v1" / "data"


@pytest.mark.parametrize("task", TASKS)
def test_the_environment_is_the_one_that_is_registered(task: str) -> None:
    from evaluator.gym import environment_id

    made = gymnasium.make(environment_id(task), protocol="end-to-end")
    assert json.loads(made.spec.to_json()) == environment(task)
    made.close()


def space(about: dict[str, Any]) -> Any:
    if about["type"] == "Discrete":
        return gymnasium.spaces.Discrete(about["n"], start=about["start"])
    low, high = (np.array(about[name], about["dtype"]) for name in ("low", "high"))
    return gymnasium.spaces.Box(low, high, tuple(about["shape"]), np.dtype(about["dtype"]))


def test_the_spaces_are_those_of_the_environment(dataset: Path) -> None:
    about = json.loads((dataset / "metadata.json").read_text())
    made = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(about["env_spec"]))
    described = json.loads(about["observation_space"])["subspaces"]
    wanted = {name: part for name, part in made.observation_space.spaces.items() if name != "valid"}
    assert {name: space(part) for name, part in described.items()} == wanted
    assert space(json.loads(about["action_space"])) == made.action_space
    made.close()


def test_an_episode_is_the_one_that_was_recorded(dataset: Path) -> None:
    about = json.loads((dataset / "metadata.json").read_text())
    with h5py.File(dataset / "main_data.hdf5") as file:
        assert len(file) == about["total_episodes"] == 12
        assert sum(episode.attrs["total_steps"] for episode in file.values()) == about["total_steps"]
        for index in range(10):
            recorded, found = synthetic_episode(BlockKey(1, TASK, "train"), index), file[f"episode_{index}"]
            assert found.attrs["options/scenario"] == f"collected/0/round-1/{TASK}/train/{index}"
            assert found["actions"][()].tolist() == [step.action.index for step in recorded.steps]
            shown = [*recorded.steps, recorded.steps[-1]]
            for n, step in enumerate(shown):
                assert np.array_equal(found["observations/scene"][n], step.observation.scene_m())
                assert np.array_equal(found["observations/end_effector"][n], step.observation.end_effector())
            outcomes = [b"", *((step.outcome.failure or "success").encode() for step in recorded.steps)]
            assert found["infos/outcome"][()].tolist() == outcomes


def test_heights_are_in_metres(release: ReleaseFolder, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="in metres") as caught:
        export_release(release, tmp_path, "minari", ExportOptions("quantised"))
    assert "--maps" in caught.value.hint and list(tmp_path.iterdir()) == []
