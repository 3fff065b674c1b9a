"""The tasks as a benchmark of vla-evaluation-harness, named by its configuration.

::

    benchmarks:
      - benchmark: "evaluator.harness.vla_eval:RemaBenchmark"
        episodes_per_task: 200
        params: {tasks: [grasp, grasp_push], split: val}

Episode n of a task is scenario n of its frozen list, and a step is one primitive. Needs ``vla-eval`` 0.8 or newer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, DimSpec

from evaluator.harness.poses import PoseEnv
from rema_data.schema import TASKS, check_task

__all__ = ["RemaBenchmark"]

_POSE = DimSpec(
    "pose", 4, "planar_xy_cos_sin", (-1, 1), description="x / 0.144 m, y / 0.144 m, cosine and sine of the yaw, world"
)
_MAP = "height_map_m"


class RemaBenchmark(StepBenchmark):  # type: ignore[misc]
    """Tasks of rema, one primitive a step.

    Parameters
    ----------
    tasks : sequence of str, optional
        All of them by default.
    split : {"val", "test"}
        The frozen lists whose scenarios are played.
    protocol : {"conditional", "end-to-end"}
    camera : bool
        Whether an observation has a picture of the world too, ``images/overview`` uint8 (480, 640, 3).

    Notes
    -----
    An observation has ``scene`` (1, 64, 64), ``end_effector`` (4, 112, 112), and the ``task_description``. Of an action
    ``actions`` is read: one pose, as ``PoseEnv`` takes it.
    """

    render_backends: ClassVar[frozenset[str]] = frozenset({"cpu", "gpu"})

    def __init__(
        self,
        tasks: Sequence[str] | None = None,
        split: str = "val",
        protocol: str = "conditional",
        camera: bool = False,
    ) -> None:
        super().__init__()
        self._tasks = [check_task(task) for task in (tasks or TASKS)]
        self._split, self._protocol, self._camera = split, protocol, camera
        self._environment: PoseEnv | None = None

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Nothing: pictures come from a software renderer."""
        return {}

    def get_tasks(self) -> list[dict[str, Any]]:
        """The tasks by name."""
        return [{"name": task, "suite": "rema"} for task in self._tasks]

    def reset(self, task: dict[str, Any]) -> Any:
        """Begin the episode ``episode_idx`` of a task."""
        if self._environment is None or self._environment.task != task["name"]:
            self.cleanup()
            render_mode = "rgb_array" if self._camera else None
            self._environment = PoseEnv(task["name"], self._split, self._protocol, render_mode)
        seen, self._info = self._environment.reset(seed=task["episode_idx"])
        return seen

    def step(self, action: dict[str, Any]) -> StepResult:
        """Carry out one primitive; the first pose where an answer has several."""
        assert self._environment is not None
        pose = np.asarray(action["actions"], np.float64).reshape(-1, 4)[0]
        seen, reward, ended, _, info = self._environment.step(pose)
        return StepResult(seen, reward, ended, info)

    def make_obs(self, raw_obs: Any, task: dict[str, Any]) -> dict[str, Any]:
        """What the model is shown."""
        assert self._environment is not None
        picture = {"images": {"overview": self._environment.render()}} if self._camera else {}
        return {**raw_obs, **picture, "task_description": self._environment.task_description}

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        """Whether the task succeeded, the label of the last step, and the name of the scenario."""
        info = step_result.info
        return {name: info.get(key, default) for name, key, default in _RESULT}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """One pose."""
        return {"pose": _POSE}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Two maps and a sentence, and a picture where it was asked for."""
        maps = {name: DimSpec(name, 0, _MAP) for name in ("scene", "end_effector")}
        return {**maps, "language": LANGUAGE, **({"image": IMAGE_RGB} if self._camera else {})}

    def get_metadata(self) -> dict[str, Any]:
        """How long an episode is at most."""
        return {"max_steps": max(len(TASKS[task]) if self._protocol == "end-to-end" else 1 for task in self._tasks)}

    def cleanup(self) -> None:
        """Release the simulator."""
        if self._environment is not None:
            self._environment.close()
            self._environment = None

    def render(self) -> Any:
        """A picture of the world, where there is a camera."""
        return self._environment.render() if self._environment is not None else None


_RESULT = (("success", "is_success", False), ("outcome", "outcome", ""), ("scenario", "scenario", ""))
