"""The embodiment and the task of Inspect Robots, found by their names and played by its own ``eval``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed: the extra `gym`")
pytest.importorskip("inspect_robots", reason="inspect-robots is not installed: nox -s harnesses")

import inspect_robots
from inspect_robots.approver import ChainApprover, ClampApprover, DeltaLimitApprover
from inspect_robots.conformance import assert_embodiment_conformant
from inspect_robots.policy import PolicyBase, PolicyInfo
from inspect_robots.scene import Scene
from inspect_robots.types import Action, ActionChunk

from evaluator.harness.inspect_robots import Rema, rema
from evaluator.harness.poses import PoseEnv
from rema_data.errors import InputError

POSES = ((0.05, -0.05, 0.0), (-0.1, 0.1, 3.0))


class Poses(PolicyBase):  # type: ignore[misc]
    """One pose after the other, whatever it is shown."""

    def __init__(self) -> None:
        self.info = PolicyInfo("poses", Rema().info.action_space, Rema().info.observation_space)
        self.asked = 0

    def act(self, observation: Any) -> ActionChunk:
        assert observation.state["scene"].shape == (1, 64, 64)
        self.asked += 1
        return ActionChunk([Action(np.array(POSES[(self.asked - 1) % len(POSES)]))])


@pytest.fixture(autouse=True)
def _frozen_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REMA_MANIFESTS", raising=False)


def test_its_runner_finds_what_the_environment_finds(tmp_path: Any) -> None:
    """Also behind the guards of its command line, which have nothing to hold back."""
    task = rema("grasp_push", scenes=2, protocol="end-to-end")
    policy, space = Poses(), Rema().info.action_space
    guards = ChainApprover(ClampApprover(space), DeltaLimitApprover(space))
    (log,) = inspect_robots.eval(task, policy, "rema", log_dir=str(tmp_path), approver=guards)
    assert log.status == "success"
    environment = PoseEnv("grasp_push", protocol="end-to-end")
    asked = 0
    for number, sample in enumerate(log.samples):
        environment.reset(seed=number)
        ended = False
        while not ended:
            *_, ended, _, info = environment.move(*POSES[asked % len(POSES)])
            asked += 1
        assert sample.scene_id == f"grasp_push-val-{number:05d}"
        assert sample.epochs[0]["success_at_end"] == float(info["is_success"])
    assert asked == policy.asked
    environment.close()


def test_its_own_check_of_an_embodiment_passes() -> None:
    for camera in (False, True):
        assert_embodiment_conformant(Rema(camera).info)


def test_both_are_found_by_name() -> None:
    from inspect_robots.registry import resolve

    assert resolve("task", "rema", task="push", scenes=3).max_steps == 1
    embodiment = resolve("embodiment", "rema", camera=True)
    scene = resolve("task", "rema", task="push", scenes=3).scenes[2]
    seen = embodiment.reset(scene)
    assert seen.images["overview"].shape == (480, 640, 3) and seen.instruction.startswith("Push")
    embodiment.close()


def test_what_cannot_be_played() -> None:
    with pytest.raises(InputError, match="2001 scenes of grasp"):
        rema("grasp", scenes=2001)
    with pytest.raises(InputError, match="has no 'task'"):
        Rema().reset(Scene("scene-0", "reach the cube"))


def test_no_pose_is_too_far_from_the_last_one() -> None:
    space = Rema().info.action_space
    assert np.allclose(space.semantics.max_step, 2 * space.high) and math.isclose(space.high[2], math.pi)
