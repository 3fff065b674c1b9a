"""The environment that other harnesses play: what an export shows, what an evaluation finds."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed: the extra `gym`")

from evaluator.gym.environment import TaskEnv  # noqa: E402
from evaluator.harness.poses import PoseEnv, make_env  # noqa: E402
from evaluator.scenarios import load_list  # noqa: E402
from evaluator.sim.observation import observe  # noqa: E402
from rema_data import grid  # noqa: E402
from rema_data.convert.layout import obs_of_scenes, planes_of_end_effectors  # noqa: E402
from rema_data.errors import InputError  # noqa: E402
from rema_data.heights import pack_mask, quantise  # noqa: E402
from rema_data.schema import TASKS  # noqa: E402
from tests.evaluator.gym.test_environment import evaluated  # noqa: E402
from tests.evaluator.harness.poses import pose_of  # noqa: E402

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def _frozen_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REMA_MANIFESTS", raising=False)


@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_own_checker_passes(task: str) -> None:
    from gymnasium.utils.env_checker import check_env

    environment = PoseEnv(task)
    check_env(environment, skip_render_check=True)
    environment.close()


def test_an_episode_is_that_of_an_evaluation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenario n of the list is the episode of seed n, and the recorded actions as poses have the recorded outcomes."""
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    environment = PoseEnv("grasp_push", protocol="end-to-end")
    for row in evaluated("grasp_push", "end-to-end", tmp_path / "run", episodes=3):
        _, info = environment.reset(seed=row["index"])
        assert info["scenario"] == row["scenario"]
        ended, step = False, 0
        while not ended:
            _, reward, ended, _, info = environment.step(pose_of(row[f"step{step}_action"]))
            assert info["outcome"] == (row[f"step{step}_failure"] or "success")
            step += 1
        assert info["is_success"] == row["success"] == bool(reward)
    environment.close()


def test_an_observation_is_that_of_an_export() -> None:
    environment = PoseEnv("grasp_push")
    found, _ = environment.reset(seed=3)
    seen = observe(load_list("grasp_push", "val").scenarios[environment._positions[3]].last_situation())
    depth_m = np.moveaxis(seen.end_effector()[..., ::2], -1, 0)
    wanted = {
        "scene": np.moveaxis(obs_of_scenes(quantise(seen.scene_m())[None], "metres"), -1, 1)[0],
        "end_effector": planes_of_end_effectors(quantise(depth_m)[None], pack_mask(seen.mask[None]), "metres")[0],
    }
    for name, maps in wanted.items():
        assert found[name].dtype == maps.dtype and np.array_equal(found[name], maps), name
    environment.close()


def test_every_grid_action_comes_back_from_its_pose() -> None:
    environment = PoseEnv("push")
    environment.reset(seed=0)
    inside = np.flatnonzero(np.repeat(grid.inside_valid_square().ravel(), grid.ANGLES))
    for action in inside[::97].tolist():
        x, y, cosine, sine = pose_of(action)
        pose_m = (x * grid.SCENE_HALF_M, y * grid.SCENE_HALF_M, float(np.arctan2(sine, cosine)))
        assert environment._index(*pose_m) == action
    environment.close()


def test_half_a_turn_of_two_arms_is_no_turn() -> None:
    """Their valid actions have half of the angles; for one hand the opposite yaw is another action."""
    for task, angle in (("grasp_grasp", 2), ("push", 10)):
        environment = PoseEnv(task)
        environment.reset(seed=0)
        assert environment._index(0.0, 0.0, 10 * 2 * np.pi / 16) % grid.ANGLES == angle
        environment.close()


@pytest.mark.parametrize("action", [[np.nan, 0, 1, 0], [0, np.inf, 1, 0], [1e300, -1e300, 1e300, 0]])
def test_an_answer_that_is_no_pose_is_a_policy_error_or_the_nearest_action(action: list[float]) -> None:
    environment = PoseEnv("grasp")
    environment.reset(seed=1)
    _, reward, ended, _, info = environment.step(np.array(action))
    assert ended and not reward
    assert (info["outcome"] == "policy_error") == (not np.isfinite(action).all())
    environment.close()


def test_what_cannot_be_played() -> None:
    with pytest.raises(InputError, match="unknown split 'train'"):
        PoseEnv("grasp", split="train")
    with pytest.raises(InputError, match="unknown protocol"):
        PoseEnv("grasp", protocol="odd")
    environment = PoseEnv("grasp")
    environment.reset(seed=0, options={"of another harness": True})
    with pytest.raises(InputError, match=r"shape \(3,\)"):
        environment.step(np.zeros(3))
    environment.close()


def hub_module() -> Any:
    """The file of the hub's repository, loaded as LeRobot loads it: by its path."""
    spec = importlib.util.spec_from_file_location("hub_env_user_name", ROOT / "examples" / "lerobot_env" / "env.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_hubs_environment_plays_every_task() -> None:
    """What LeRobot asks of a vector: attributes of the environments, and who succeeded."""
    made = hub_module().make_env(n_envs=2)
    assert list(made) == ["rema"] and len(made["rema"]) == len(TASKS)
    for task, vector in zip(TASKS, made["rema"].values(), strict=True):
        assert vector.call("task") == (task, task)
        assert vector.call("_max_episode_steps") == (1, 1)
        seen, _ = vector.reset(seed=[0, 1], options={"lerobot_new_rollout": True})
        assert seen["scene"].shape == (2, 1, 64, 64) and seen["end_effector"].shape == (2, 4, 112, 112)
        _, rewards, ended, _, info = vector.step(np.tile(np.array([0, 0, 1, 0], np.float32), (2, 1)))
        assert ended.all() and info["is_success"].tolist() == (rewards > 0).tolist()
        vector.close()


def test_processes_of_the_hubs_environment() -> None:
    config = SimpleNamespace(task="grasp_push", split="val", protocol="end-to-end")
    (vector,) = make_env(2, True, config)["rema"].values()
    assert isinstance(vector, gymnasium.vector.AsyncVectorEnv)
    assert vector.call("_max_episode_steps") == (2, 2)
    _, info = vector.reset(seed=[5, 6])
    assert [name.rsplit("/", 1)[1] for name in info["scenario"]] == ["00005", "00006"]
    vector.close()


def test_no_environments() -> None:
    with pytest.raises(InputError, match="n_envs is 0"):
        make_env(0)


def test_the_pictures_are_those_of_the_environment() -> None:
    environment, other = (
        PoseEnv("grasp", render_mode="rgb_array"),
        TaskEnv("grasp", domain="val", render_mode="rgb_array"),
    )
    environment.reset(seed=4)
    other.reset(options={"scenario": environment._positions[4]})
    assert np.array_equal(environment.render(), other.render())
    environment.close()
    other.close()
