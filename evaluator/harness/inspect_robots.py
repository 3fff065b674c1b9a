"""The tasks in Inspect Robots: the embodiment ``rema``, and the task ``rema``, whose scenes are frozen scenarios.

::

    inspect-robots run --task rema -T task=grasp_push -T scenes=200 --embodiment rema --policy my-policy

A step is one primitive. Needs ``inspect-robots`` 0.60 or newer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from inspect_robots import Task
from inspect_robots.embodiment import PRIVILEGED_SUCCESS, RENDERABLE, RESETTABLE, EmbodimentBase, EmbodimentInfo
from inspect_robots.scene import Scene
from inspect_robots.scorer import success_at_end
from inspect_robots.spaces import ActionSemantics, Box, CameraSpec, ObservationSpace, StateField, StateSpec
from inspect_robots.types import Action, Observation, StepResult

from evaluator.harness.poses import PoseEnv
from rema_data.convert.layout import INSTRUCTIONS
from rema_data.errors import InputError
from rema_data.grid import EE_PIXELS, SCENE_HALF_M, SCENE_PIXELS
from rema_data.schema import TASKS, check_task

__all__ = ["Rema", "rema"]

_HIGHEST = np.array([SCENE_HALF_M, SCENE_HALF_M, math.pi])
_POSES = Box(
    shape=(3,),
    low=-_HIGHEST,
    high=_HIGHEST,
    semantics=ActionSemantics(
        "eef_abs_pose",
        frame="world",
        dim_labels=("x_m", "y_m", "yaw_rad"),
        max_step=tuple(2 * _HIGHEST),  # a primitive brings the hand there by itself: no pose is too far from the last
    ),
)
_STATE = StateSpec(
    (
        StateField("pose", _POSES.shape, "m, m, rad"),
        StateField("scene", (1, SCENE_PIXELS, SCENE_PIXELS), "m", "float32"),
        StateField("end_effector", (4, EE_PIXELS, EE_PIXELS), "m", "float32"),
    )
)
_CAMERA = CameraSpec("overview", 480, 640)
_DOCS = """\
One action is one whole primitive (a grasp, or a push along +x), carried out with the hand at x, y and yaw.
World frame: metres, origin at the centre of the table, z up. Only the central 0.252 m by 0.252 m may be acted on.
State `scene` is the height above the table: row i grows with y, column j with x, 4.5 mm a pixel, centre at the origin.
State `end_effector` is the hand or the tool that acts, seen from above at yaw 0, in the same scale: height and mask at
the start of the primitive, height and mask at its end. State `pose` is the last action, zero before the first."""


class Rema(EmbodimentBase):  # type: ignore[misc]
    """Two arms above a table; a scene of the task ``rema`` says what lies there.

    Parameters
    ----------
    camera : bool
        Whether an observation has a picture of the world, ``overview``.
    """

    def __init__(self, camera: bool = False) -> None:
        self._camera = camera
        self._environments: dict[tuple[str, str, str], PoseEnv] = {}
        self._now: PoseEnv | None = None
        self.info = EmbodimentInfo(
            name="rema",
            action_space=_POSES,
            observation_space=ObservationSpace((_CAMERA,) if camera else (), state=_STATE),
            control_hz=1.0,  # a primitive has no duration: a step counts as a second, as in an export for LeRobot
            is_simulated=True,
            capabilities=frozenset({RESETTABLE, PRIVILEGED_SUCCESS} | ({RENDERABLE} if camera else set())),
            docs=_DOCS,
        )

    def reset(self, scene: Scene, *, seed: int | None = None) -> Observation:
        """Begin the scenario of a scene; nothing is left to a seed."""
        try:
            task, split, protocol, index = (scene.metadata[key] for key in ("task", "split", "protocol", "index"))
        except KeyError as error:
            raise InputError(
                f"the scene {scene.id!r} has no {error.args[0]!r}: it is none of rema",
                hint="inspect-robots run --task rema",
            ) from error
        key = (task, split, protocol)
        if key not in self._environments:
            self._environments[key] = PoseEnv(*key, "rgb_array" if self._camera else None)
        self._now = self._environments[key]
        seen, _ = self._now.reset(seed=index)
        return self._observation(seen, np.zeros(_POSES.shape))

    def step(self, action: Action) -> StepResult:
        """Carry out one primitive."""
        assert self._now is not None
        pose = np.asarray(action.data, np.float64).reshape(_POSES.shape)
        seen, reward, ended, _, info = self._now.move(*pose.tolist())
        about = {key: info[key] for key in ("scenario", "outcome", "evidence")} | {"success": info["is_success"]}
        return StepResult(self._observation(seen, pose), reward, ended, info["outcome"] if ended else None, info=about)

    def close(self) -> None:
        """Release the simulators."""
        for environment in self._environments.values():
            environment.close()
        self._environments.clear()

    def _observation(self, seen: dict[str, Any], pose: npt.NDArray[np.float64]) -> Observation:
        assert self._now is not None
        images = {_CAMERA.name: self._now.render()} if self._camera else {}
        return Observation(images=images, state={"pose": pose, **seen}, instruction=self._now.task_description)


def rema(task: str = "grasp", scenes: int = 100, split: str = "val", protocol: str = "conditional") -> Task:
    """The first so many scenarios of a frozen list of a task, scored by the success of the last step."""
    steps = len(TASKS[check_task(task)]) if protocol == "end-to-end" else 1
    environment = PoseEnv(task, split, protocol)
    most = environment.scenarios
    environment.close()
    if not 1 <= scenes <= most:
        raise InputError(f"{scenes} scenes of {task}", hint=f"choose from 1 to {most:,}: the list has no more")
    about = {"task": task, "split": split, "protocol": protocol}
    return Task(
        name=f"rema-{task}-{split}-{protocol}",
        scenes=[
            Scene(f"{task}-{split}-{n:05d}", INSTRUCTIONS[task], metadata={**about, "index": n}) for n in range(scenes)
        ],
        scorer=success_at_end(),
        max_steps=steps,
        metadata=about,
    )
