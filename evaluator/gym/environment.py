"""A task as a Gymnasium environment: one step of the environment is one primitive, carried out to its end."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from evaluator.gym.draws import TRAIN, Draws
from evaluator.protocol import PROTOCOLS
from evaluator.render.film import FilmMaker, waiting_shot
from evaluator.render.studio import Studio
from evaluator.rollout.ask import attempt, question
from evaluator.rollout.backend import default_backend
from evaluator.rollout.episode import first_step, next_step
from evaluator.run.records import POLICY_FAULT
from evaluator.sim.observation import SLAB_M
from evaluator.sim.simulator import Simulator
from rema_data import grid
from rema_data.errors import InputError
from rema_data.schema import HEIGHT_STEP_M, TASKS, Scenario, Situation, check_task

__all__ = ["TaskEnv"]

_OPTIONS = {"scenario"}


class TaskEnv(gymnasium.Env[dict[str, Any], np.int64]):
    """A task of rema.

    Parameters
    ----------
    task : str
    protocol : {"conditional", "end-to-end"}
        Only the last step, with tools in hand; or every step, from empty hands.
    domain : {"train", "test", "val"}
        Where the scenarios of ``reset`` come from: new ones by default, or a frozen list.
    render_mode : {"rgb_array"}, optional

    Raises
    ------
    InputError
        There is no such task, protocol, domain or render mode.

    Notes
    -----
    An observation has ``scene`` float32 (64, 64), metres; ``end_effector`` float32 (112, 112, 4), depth in metres and
    mask of two states; ``valid`` int8 (64, 64, 16), 1 for the actions that may be chosen; and ``step``, the position
    of the next primitive in the task. The first three are what ``rema evaluate`` shows a policy.

    An action is one grid index ``(i * 64 + j) * 16 + k``. One that is not valid ends the episode with the label
    ``policy_error``, as in an evaluation. The reward is 1 when the last step succeeds and 0 otherwise; the episode ends
    with its last or its first failed step, and its last observation stays what it was.

    After a step, ``info`` has its ``outcome`` (``success`` or a failure label), ``is_success`` (of the task) and
    ``evidence``. ``scenario`` names a frozen scenario and is empty for a new one.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012 - as its base says

    def __init__(
        self, task: str, protocol: str = "conditional", domain: str = TRAIN, render_mode: str | None = None
    ) -> None:
        steps = TASKS[check_task(task)]
        for name, value, allowed in (
            ("protocol", protocol, tuple(PROTOCOLS)),
            ("render mode", render_mode, (None, *self.metadata["render_modes"])),
        ):
            if value not in allowed:
                choices = ", ".join(str(choice) for choice in allowed)
                raise InputError(f"unknown {name} {value!r}", hint=f"choose one of: {choices}")
        self.render_mode = render_mode
        self.action_space = spaces.Discrete(grid.ACTIONS)
        self.observation_space = spaces.Dict(
            {
                "scene": spaces.Box(0.0, _metres(SLAB_M), (grid.SCENE_PIXELS,) * 2, np.float32),
                "end_effector": spaces.Box(
                    0.0, np.broadcast_to(np.array([_metres(SLAB_M), 1.0] * 2, np.float32), _EFFECTOR), dtype=np.float32
                ),
                "valid": spaces.MultiBinary((grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES)),
                "step": spaces.Discrete(len(steps)),
            }
        )
        self._protocol = protocol
        self._backend = default_backend()
        self._draws = Draws(task, domain, protocol)
        self._simulator = Simulator()
        self._studio: Studio | None = None
        self._name = ""
        self._scenario: Scenario | None = None
        self._situation: Situation | None = None
        self._action: int | None = None  # that was carried out in the step that ended the episode
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Of everything that is drawn from now on.
        options : dict, optional
            ``{"scenario": 17}`` chooses by position in the frozen list (of ``val`` in the training domain), and
            ``{"scenario": "v1/grasp_push/test/00017"}`` by name. With the end-to-end protocol,
            ``{"scenario": "collected/0/round-1/grasp_push/train/17"}`` is an episode of a release: root seed, block
            and episode.

        Raises
        ------
        InputError
            There is no such option or scenario.
        MissingFileError, IntegrityError
            The frozen list cannot be read.
        """
        super().reset(seed=seed)
        options = options or {}
        if unknown := sorted(set(options) - _OPTIONS):
            raise InputError(f"unknown option {unknown[0]!r}", hint=f"known: {', '.join(_OPTIONS)}")
        name = options.get("scenario")
        start = self._draws.draw(self.np_random, self._simulator) if name is None else self._draws.named(name)
        self._name, self._scenario = start
        self._situation = first_step(start.scenario, self._protocol)
        self._action, self._ended = None, False
        return self._observation(self._situation), self._info(self._situation)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Carry out one primitive, a grid index.

        Raises
        ------
        InputError
            It is not in the action space.
        gymnasium.error.ResetNeeded
            No episode is under way.
        """
        if self._ended or self._situation is None or self._scenario is None:
            raise gymnasium.error.ResetNeeded("the episode has ended: call reset()")
        index = self._index(action)
        situation = self._situation
        outcome = attempt(self._simulator.run, self._backend, situation, index)
        following = next_step(self._scenario, situation, outcome)
        self._ended = following is None
        if following is None:
            self._action = None if outcome is POLICY_FAULT else index
        else:
            self._situation = following
        won = outcome.success and situation.last
        info = self._info(self._situation) | {
            "outcome": "success" if outcome.failure is None else outcome.failure.value,
            "is_success": won,
            "evidence": outcome.evidence(),
        }
        return self._observation(self._situation), float(won), self._ended, False, info

    def render(self) -> Any:
        """The world before the next primitive, or at the end of the last one: uint8 (480, 640, 3)."""
        if self.render_mode is None or self._situation is None:
            return None
        if self._studio is None:
            self._studio = Studio()
        situation, target = self._situation, self._situation.target
        if self._action is None:
            return self._studio.photograph(waiting_shot(situation, int(grid.snap(target.x_m, target.y_m, 0.0))))
        with FilmMaker() as films:  # the step is carried out again, to be seen
            return self._studio.photograph(films.take(situation, self._action).after)

    def close(self) -> None:
        """Release the simulator and the studio."""
        self._simulator.close()
        if self._studio is not None:
            self._studio.close()
            self._studio = None

    def _index(self, action: Any) -> int:
        value = np.asarray(action)
        if value.ndim or not np.issubdtype(value.dtype, np.integer) or not 0 <= value < grid.ACTIONS:
            raise InputError(
                f"{action!r} is not an action",
                hint=f"give a grid index from 0 to {grid.ACTIONS - 1}: (i * 64 + j) * 16 + k",
                action=repr(action),
            )
        return int(value)

    def _observation(self, situation: Situation) -> dict[str, Any]:
        seen = question(self._backend, [situation])
        return {
            "scene": seen.scene[0],
            "end_effector": np.ascontiguousarray(seen.end_effector[0]),
            "valid": seen.valid[0].astype(np.int8),
            "step": np.int64(situation.step),
        }

    def _info(self, situation: Situation) -> dict[str, Any]:
        kind = situation.kind
        return {"scenario": self._name, "primitive": kind.primitive.value, "embodiment": kind.embodiment.value}


_EFFECTOR = (grid.EE_PIXELS, grid.EE_PIXELS, 4)


def _metres(height_m: float) -> npt.NDArray[np.float32] | np.float32:
    """A height as the maps hold it: a multiple of their resolution, rounded as theirs are."""
    return np.float32(np.uint16(round(height_m / HEIGHT_STEP_M)) * np.float32(HEIGHT_STEP_M))
