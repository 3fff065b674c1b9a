"""The environments keep Gymnasium's contract, and an episode in one is an episode of an evaluation."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from evaluator.policy import resolve
from evaluator.runner import EvaluationConfig, run_evaluation
from evaluator.scenarios import VERSION, load_list, scenario_id
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.errors import InputError
from rema_data.schema import TASKS

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed: the extra `gym`")

from evaluator.gym import ENVIRONMENTS, environment_id  # noqa: E402
from evaluator.gym.environment import TaskEnv  # noqa: E402


@pytest.fixture(autouse=True)
def _frozen_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REMA_MANIFESTS", raising=False)


def made(task: str, **changes: Any) -> Any:
    return gymnasium.make(environment_id(task), **changes)


def valid_action(environment: Any, observation: dict[str, Any]) -> int:
    return int(environment.action_space.sample(mask=observation["valid"].ravel()))


def same(one: Any, other: Any) -> bool:
    return set(one) == set(other) and all(np.array_equal(one[name], other[name]) for name in one)


def test_every_task_has_an_environment() -> None:
    assert ENVIRONMENTS == {
        "rema/Grasp-v1": "grasp",
        "rema/Push-v1": "push",
        "rema/GraspGrasp-v1": "grasp_grasp",
        "rema/GraspPush-v1": "grasp_push",
        "rema/GraspGraspPush-v1": "grasp_grasp_push",
    }
    assert set(ENVIRONMENTS.values()) == set(TASKS)


@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_own_checker_passes(task: str) -> None:
    """Its warnings are errors here."""
    from gymnasium.utils.env_checker import check_env

    for protocol, domain in (("conditional", "val"), ("end-to-end", "train")):
        environment = made(task, protocol=protocol, domain=domain)
        check_env(environment.unwrapped, skip_render_check=(task, protocol) != ("grasp_push", "conditional"))
        environment.close()


def evaluated(task: str, protocol: str, folder: Path, episodes: int = 6) -> list[dict[str, Any]]:
    """Rows of a run of the scripted policy over the validation list."""
    config = EvaluationConfig(
        resolve("scripted"), task, folder, protocol=protocol, split="val", episodes=episodes, engine="inline"
    )
    run_evaluation(config)
    rows: list[dict[str, Any]] = pq.read_table(folder / "results.parquet").to_pylist()
    return rows


@pytest.mark.parametrize(
    ("task", "protocol"),
    [*((task, "conditional") for task in TASKS if task != "grasp_grasp_push"), ("grasp_grasp_push", "end-to-end")],
)
def test_an_episode_is_that_of_an_evaluation(
    task: str, protocol: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    environment = made(task, protocol=protocol, domain="val")
    played = 0
    for row in evaluated(task, protocol, tmp_path / "run"):
        _, info = environment.reset(options={"scenario": row["index"]})
        assert info["scenario"] == row["scenario"]
        terminated, reward, step = False, 0.0, len(TASKS[task]) - 1 if protocol == "conditional" else 0
        while not terminated:
            _, reward, terminated, _, info = environment.step(row[f"step{step}_action"])
            assert info["outcome"] == (row[f"step{step}_failure"] or "success")
            for name, value in info["evidence"].items():
                assert value == row[f"step{step}_{name}"], name
            step += 1
            played += 1
        assert info["is_success"] == row["success"] == bool(reward)
    assert played >= 6
    environment.close()


def test_observations_are_those_of_an_evaluation() -> None:
    environment = made("grasp_push", domain="val")
    observation, _ = environment.reset(options={"scenario": 3})
    seen = observe(load_list("grasp_push", "val").scenarios[3].last_situation())
    assert np.array_equal(observation["scene"], seen.scene_m())
    assert np.array_equal(observation["end_effector"], seen.end_effector())
    assert np.array_equal(observation["valid"].astype(bool), valid_actions("grasp_push", 1))
    assert observation["step"] == 1
    environment.close()


@pytest.mark.parametrize("protocol", ["conditional", "end-to-end"])
def test_a_seed_decides_scenarios_and_outcomes(protocol: str) -> None:
    runs = []
    for seed in (7, 7, 8):
        environment = made("grasp_push", protocol=protocol)
        environment.action_space.seed(1)
        episodes = []
        for n in range(3):
            observation, before = environment.reset(seed=seed if n == 0 else None)
            after = environment.step(valid_action(environment, observation))
            episodes.append((observation, before, after[1:]))
        runs.append(episodes)
        environment.close()
    assert all(same(one[0], other[0]) and one[1:] == other[1:] for one, other in zip(runs[0], runs[1], strict=True))
    assert not any(same(one[0], other[0]) for one, other in zip(runs[0], runs[2], strict=True))
    assert not same(runs[0][0][0], runs[0][1][0])


def test_the_test_list_is_met_only_by_name() -> None:
    """Scenarios are new ones by default; a position without a list means one of the validation list."""
    environment = made("push")
    frozen = {scenario.placements for split in ("test", "val") for scenario in load_list("push", split).scenarios}
    for seed in range(20):
        _, info = environment.reset(seed=seed)
        assert info["scenario"] == ""
        assert environment.unwrapped._scenario.placements not in frozen
    assert environment.reset(options={"scenario": 4})[1]["scenario"] == f"{VERSION}/push/val/00004"
    name = scenario_id(VERSION, load_list("push", "test").scenarios[4])
    assert environment.reset(options={"scenario": name})[1]["scenario"] == name
    validation = made("push", domain="val")
    names = {validation.reset(seed=seed)[1]["scenario"] for seed in range(10)}
    assert len(names) > 5 and all(name.startswith(f"{VERSION}/push/val/") for name in names)


def test_info_has_no_outcome_before_the_step() -> None:
    environment = made("grasp", domain="val")
    observation, info = environment.reset(seed=1)
    assert info == {"scenario": info["scenario"], "primitive": "grasp", "embodiment": "gripper"}
    *_, info = environment.step(valid_action(environment, observation))
    assert {"outcome", "is_success", "evidence"} <= set(info)


def test_an_invalid_action_is_a_policy_error() -> None:
    environment = made("grasp", domain="val")
    observation, _ = environment.reset(seed=1)
    again, reward, terminated, truncated, info = environment.step(0)
    assert (reward, terminated, truncated, info["outcome"]) == (0.0, True, False, "policy_error")
    assert same(observation, again)
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(0)


@pytest.mark.parametrize("action", [-1, 65_536, 1.5, [3], "4"])
def test_values_that_are_not_actions(action: Any) -> None:
    environment = TaskEnv("grasp")
    environment.reset(seed=1)
    with pytest.raises(InputError, match="not an action"):
        environment.step(action)


def test_environments_do_not_disturb_each_other() -> None:
    alone, one, two = (made("grasp", domain="val") for _ in range(3))
    outcomes: dict[str, list[Any]] = {"alone": [], "beside": []}
    scripted = [row["step0_action"] for row in _scripted_grasps()]
    for index, action in enumerate(scripted):
        alone.reset(options={"scenario": index})
        outcomes["alone"].append(alone.step(action)[4])
    for index, action in enumerate(scripted):
        one.reset(options={"scenario": index})
        two.reset(options={"scenario": index + 1})
        two.step(scripted[0])
        outcomes["beside"].append(one.step(action)[4])
    assert outcomes["alone"] == outcomes["beside"]


def _scripted_grasps() -> list[dict[str, Any]]:
    """Actions that close on the object's middle: Bullet has something to do."""
    from rema_data import grid

    found = []
    for scenario in load_list("grasp", "val").scenarios[:4]:
        target = scenario.placements[0]
        found.append({"step0_action": int(grid.snap(target.x_m, target.y_m, target.yaw_rad + np.pi / 2))})
    return found


def test_a_vector_of_them() -> None:
    vector = gymnasium.make_vec("rema/Push-v1", num_envs=2, vectorization_mode="sync", domain="val")
    observation, _ = vector.reset(seed=3)
    assert observation["scene"].shape == (2, 64, 64)
    actions = [int(np.flatnonzero(valid)[100]) for valid in observation["valid"]]
    _, rewards, terminated, _, info = vector.step(np.array(actions))
    assert rewards.shape == (2,) and terminated.all() and len(info["outcome"]) == 2
    vector.close()


@pytest.mark.parametrize("task", TASKS)
def test_pictures_before_and_after(task: str) -> None:
    environment = made(task, domain="val", render_mode="rgb_array")
    observation, _ = environment.reset(seed=2)
    before = environment.render()
    environment.step(valid_action(environment, observation))
    after = environment.render()
    assert before.shape == after.shape == (480, 640, 3) and before.dtype == np.uint8
    assert len(np.unique(before)) > 20 and not np.array_equal(before, after)
    environment.close()


@pytest.mark.parametrize(
    "changes", [{"protocol": "odd"}, {"domain": "tests"}, {"render_mode": "human"}, {"task": "stack"}]
)
def test_impossible_environments(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="unknown"):
        TaskEnv(**{"task": "grasp", **changes})


@pytest.mark.parametrize(
    "options", [{"scenario": 2000}, {"scenario": -1}, {"scenario": f"{VERSION}/push/val/00001"}, {"scenarios": 3}]
)
def test_scenarios_that_are_not_there(options: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        TaskEnv("grasp").reset(options=options)


def test_names_are_found_without_an_import() -> None:
    code = (
        "import gymnasium, json; e = gymnasium.make('evaluator.gym:rema/Grasp-v1'); "
        "print(json.dumps([e.unwrapped.spec.id, e.unwrapped.metadata['render_modes']]))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert json.loads(said) == ["rema/Grasp-v1", ["rgb_array"]]


def test_without_gymnasium() -> None:
    code = (
        "import sys; sys.modules['gymnasium'] = None\ntry:\n  import evaluator.gym\nexcept ImportError as e: print(e)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert 'pip install "rema[gym]"' in said


def test_the_code_of_the_page_runs() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "gymnasium.md").read_text(encoding="utf-8")
    lines = page[page.index("    import gymnasium") : page.index("environment.close()")].splitlines()
    code = "\n".join(line.removeprefix("    ") for line in lines)
    assert "environment.step(action)" in code
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.split()[-1] in ("0.0", "1.0")


def collected(task: str, index: int) -> str:
    return f"collected/3/round-2/{task}/train/{index}"


def test_a_collected_episode_is_drawn_again() -> None:
    """The objects are those that a collection with this seed has in this episode."""
    from baselines.rounds.play import draw_scenario
    from rema_data.schema import Scenario
    from rema_data.store.block import BlockKey

    environment = made("grasp_push", protocol="end-to-end")
    found, info = environment.reset(options={"scenario": collected("grasp_push", 5)})
    objects = draw_scenario(3, BlockKey(2, "grasp_push", "train"), 5).placements
    wanted = observe(Scenario("grasp_push", "train", 5, objects).first_situation())
    assert info["scenario"] == collected("grasp_push", 5)
    assert np.array_equal(found["scene"], wanted.scene_m())
    environment.close()


def test_a_collected_episode_begins_with_empty_hands() -> None:
    environment = made("grasp_push")
    with pytest.raises(InputError, match="begins with empty hands") as caught:
        environment.reset(options={"scenario": collected("grasp_push", 5)})
    assert "end-to-end" in caught.value.hint
    with pytest.raises(InputError, match="is not a scenario of grasp_push"):
        environment.reset(options={"scenario": collected("push", 5)})
    environment.close()
