"""A task as other harnesses play it: actions are poses, and an episode is chosen by its number in a frozen list."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from evaluator.gym.draws import Draws
from evaluator.gym.environment import TaskEnv
from evaluator.scenarios import SPLITS
from rema_data import grid
from rema_data.convert.layout import INSTRUCTIONS
from rema_data.errors import InputError
from rema_data.schema import TASK_NUMBERS, TASKS

__all__ = ["PoseEnv", "make_env"]

Array = npt.NDArray[Any]
Step = tuple[dict[str, Array], float, bool, bool, dict[str, Any]]
"""Observation, reward, whether the episode has ended, False, and what happened."""
_NO_ACTION = 0
"""A corner of the grid, which is outside of the valid square: the answer of a policy that gives none."""


class PoseEnv(gymnasium.Env[dict[str, Any], Array]):
    """A task of rema with the observations and actions of ``rema export --format lerobot``.

    Parameters
    ----------
    task : str
    split : {"val", "test"}
        The frozen list whose scenarios are played.
    protocol : {"conditional", "end-to-end"}
    render_mode : {"rgb_array"}, optional

    Attributes
    ----------
    task, task_description : str
        The name of the task, and what it asks for in a sentence.
    scenarios : int
        Scenarios of the list that the protocol can be played on.

    Raises
    ------
    InputError
        There is no such task, split, protocol or render mode.

    Notes
    -----
    An observation has ``scene`` float32 (1, 64, 64) and ``end_effector`` float32 (4, 112, 112), in metres. An action is
    float32 (4,): x and y of the hand in the world over 0.144 m, cosine and sine of its yaw. It means the nearest action
    of the grid; where half a turn makes no difference, the yaw is taken modulo half a turn. What cannot be reached, or
    is not finite, ends the episode as ``policy_error``.
    """

    metadata = TaskEnv.metadata

    def __init__(
        self, task: str, split: str = "val", protocol: str = "conditional", render_mode: str | None = None
    ) -> None:
        if split not in SPLITS:
            raise InputError(f"unknown split {split!r}", hint=f"choose one of: {', '.join(SPLITS)}", split=split)
        self._inner = TaskEnv(task, protocol, split, render_mode)
        self._positions = Draws(task, split, protocol).playable
        self._valid: Array | None = None
        self.task, self.task_description = task, INSTRUCTIONS[task]
        self.render_mode = render_mode
        self.scenarios = len(self._positions)
        self._max_episode_steps = len(TASKS[task]) if protocol == "end-to-end" else 1  # LeRobot asks for it
        inner: Any = self._inner.observation_space
        highest = {name: inner[name].high for name in ("scene", "end_effector")}
        self.observation_space = spaces.Dict(
            {name: spaces.Box(0.0, planes, dtype=np.float32) for name, planes in _planes(highest).items()}
        )
        self.action_space = spaces.Box(-1.0, 1.0, (4,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            The number of the scenario in the list, modulo ``scenarios``; one is drawn by default.
        options : dict, optional
            ``{"scenario": name}`` chooses by name; what a harness puts there besides is ignored.
        """
        super().reset(seed=seed)
        name = (options or {}).get("scenario")
        if name is None:
            number = int(self.np_random.integers(self.scenarios)) if seed is None else seed
            name = self._positions[number % self.scenarios]
        seen, info = self._inner.reset(options={"scenario": name})
        return self._shown(seen), info

    def step(self, action: Any) -> Step:
        """Carry out one primitive at a pose, (x / 0.144 m, y / 0.144 m, cos yaw, sin yaw).

        Raises InputError for another shape, and ResetNeeded where no episode is under way.
        """
        pose = np.asarray(action, np.float64)
        if pose.shape != self.action_space.shape:
            raise InputError(
                f"an action has the shape {pose.shape}, not (4,)",
                hint="give x / 0.144 m, y / 0.144 m, cos(yaw), sin(yaw)",
            )
        with np.errstate(invalid="ignore"):
            x, y, cosine, sine = pose
            return self.move(x * grid.SCENE_HALF_M, y * grid.SCENE_HALF_M, float(np.arctan2(sine, cosine)))

    def move(self, x_m: float, y_m: float, yaw_rad: float) -> Step:
        """Carry out one primitive at a pose in the world; see ``step``."""
        seen, reward, ended, truncated, info = self._inner.step(self._index(x_m, y_m, yaw_rad))
        return self._shown(seen), reward, ended, truncated, info

    def render(self) -> Any:
        """See ``TaskEnv``."""
        return self._inner.render()

    def close(self) -> None:
        """Release the simulator."""
        self._inner.close()

    def _index(self, x_m: float, y_m: float, yaw_rad: float) -> int:
        if not np.isfinite([x_m, y_m, yaw_rad]).all():
            return _NO_ACTION
        x, y = np.clip([x_m, y_m], -grid.SCENE_HALF_M, grid.SCENE_HALF_M)
        i, j, k = grid.decode(int(grid.snap(x, y, yaw_rad % (2 * np.pi))))
        half = grid.ANGLES // 2
        if self._valid is not None and k >= half and not self._valid[:, :, half:].any():
            k -= half
        return int(grid.encode(i, j, k))

    def _shown(self, seen: dict[str, Any]) -> dict[str, Array]:
        self._valid = seen["valid"]
        return _planes(seen)


def _planes(seen: dict[str, Any]) -> dict[str, Array]:
    """Maps with their planes first."""
    hand = np.ascontiguousarray(np.moveaxis(seen["end_effector"], -1, 0))
    return {"scene": seen["scene"][None], "end_effector": hand}


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
    """Environments as an environment of LeRobot's hub gives them: by suite and number of the task.

    Parameters
    ----------
    n_envs : int
        How many of each task step together.
    use_async_envs : bool
        Whether each of them has a process of its own.
    cfg : optional
        ``task`` (all tasks by default), ``split`` and ``protocol``, as in ``evaluator.harness.lerobot.RemaConfig``.
    """
    if n_envs < 1:
        raise InputError(f"n_envs is {n_envs}", hint="give 1 or more")
    split, protocol = getattr(cfg, "split", "val"), getattr(cfg, "protocol", "conditional")
    chosen = getattr(cfg, "task", None)
    made: dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]] = {}
    for task in [chosen] if chosen else TASKS:
        one = partial(PoseEnv, task, split, protocol, "rgb_array")
        if use_async_envs and n_envs > 1:
            made[TASK_NUMBERS[task]] = gymnasium.vector.AsyncVectorEnv([one] * n_envs, context="forkserver")
        else:
            made[TASK_NUMBERS[task]] = gymnasium.vector.SyncVectorEnv([one] * n_envs)
    return {"rema": made}
