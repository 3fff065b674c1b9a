"""The benchmark of vla-evaluation-harness, played by its own runner against a model server of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed: the extra `gym`")
vla_eval = pytest.importorskip("vla_eval", reason="vla-eval is not installed: nox -s harnesses")

from vla_eval.model_servers.predict import PredictModelServer  # noqa: E402

from evaluator.harness.poses import PoseEnv  # noqa: E402
from evaluator.harness.vla_eval import RemaBenchmark  # noqa: E402

POSES = np.array([[0.0, 0.0, 1.0, 0.0], [0.1, -0.2, 0.0, 1.0]], np.float32)


class Server(PredictModelServer):  # type: ignore[misc]
    """One pose after the other, whatever it is shown; it remembers what that was."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[dict[str, Any]] = []

    def predict(self, obs: dict[str, Any], ctx: Any) -> dict[str, Any]:
        self.seen.append(obs)
        return {"actions": POSES[(len(self.seen) - 1) % len(POSES)]}

    def get_action_spec(self) -> dict[str, Any]:
        return RemaBenchmark().get_action_spec()

    def get_observation_spec(self) -> dict[str, Any]:
        return RemaBenchmark().get_observation_spec()


@pytest.fixture(autouse=True)
def _frozen_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REMA_MANIFESTS", raising=False)


@pytest.mark.filterwarnings("default")
def test_its_runner_finds_what_the_environment_finds(tmp_path: Any, caplog: pytest.LogCaptureFixture) -> None:
    server = Server()
    entry = {
        "benchmark": "evaluator.harness.vla_eval:RemaBenchmark",
        "episodes_per_task": 2,
        "params": {"tasks": ["push", "grasp"]},
    }
    (result,) = vla_eval.evaluate(server, {"benchmarks": [entry]}, output_dir=tmp_path, docker=False)
    assert "Spec mismatch" not in caplog.text
    for task in result["tasks"]:
        environment = PoseEnv(task["task"])
        assert len(task["episodes"]) == 2
        for episode in task["episodes"]:
            number = episode["episode_id"]
            seen, _ = environment.reset(seed=number)
            *_, info = environment.step(POSES[number % len(POSES)])
            assert "failure_reason" not in episode
            assert episode["metrics"]["success"] == info["is_success"]
            assert any(np.array_equal(shown["scene"], seen["scene"]) for shown in server.seen)
        environment.close()
    assert {shown["task_description"][:4] for shown in server.seen} == {"Push", "Gras"}


def test_a_picture_where_it_is_asked_for() -> None:
    benchmark = RemaBenchmark(["grasp"], camera=True)
    (task,) = benchmark.get_tasks()
    task = {**task, "episode_idx": 1}
    shown = benchmark.make_obs(benchmark.reset(task), task)
    assert shown["images"]["overview"].shape == (480, 640, 3)
    assert set(benchmark.get_observation_spec()) == {"scene", "end_effector", "language", "image"}
    assert benchmark.configure_render("cpu") == {}
    benchmark.cleanup()
    assert benchmark.render() is None


def test_an_episode_has_as_many_steps_as_the_longest_task() -> None:
    assert RemaBenchmark().get_metadata() == {"max_steps": 1}
    assert RemaBenchmark(protocol="end-to-end").get_metadata() == {"max_steps": 4}
