"""Drawing objects: shapes, sizes and poses from a generator that the caller keys by episode."""

from __future__ import annotations

import numpy as np

from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import WORLD, WorldParameters
from rema_data.schema import TASK_NUMBERS, TASKS, ObjectSpec, Placement, Shape, StepKind, tool_steps


def episode_generator(root: int, domain: str, task: str, episode: int) -> np.random.Generator:
    """The generator of one episode of a list; ``domain`` is ``test``, ``val`` or ``calibrate``. Streams never meet."""
    key = (_DOMAINS[domain], TASK_NUMBERS[task], episode)
    return np.random.default_rng(np.random.SeedSequence(root, spawn_key=key))


def collection_generator(root: int, round_: int, task: str, split: str, episode: int) -> np.random.Generator:
    """The generator of one collected episode: rounds count from 1, episodes of a (round, task, split) from 0."""
    key = (_DOMAINS["collect"], TASK_NUMBERS[task], round_, _SPLITS[split], episode)
    return np.random.default_rng(np.random.SeedSequence(root, spawn_key=key))


_DOMAINS = {"test": 0, "val": 1, "collect": 2, "calibrate": 3}
_SPLITS = {"train": 0, "val": 1}


def draw_spec(rng: np.random.Generator, stick: bool, parameters: WorldParameters = WORLD) -> ObjectSpec:
    """A random object: I, L or T equally often, or a stick (a long I), scaled along and across its bar."""
    p = parameters
    shape = Shape.I if stick else (Shape.I, Shape.L, Shape.T)[int(rng.integers(3))]
    lengths = (p.stick_length_min_m, p.stick_length_max_m) if stick else (p.length_min_m, p.length_max_m)
    widths = (p.stick_width_min_m, p.stick_width_max_m) if stick else (p.width_min_m, p.width_max_m)
    length, width = float(rng.uniform(*lengths)), float(rng.uniform(*widths))
    arm = 0.0 if shape is Shape.I else p.arm_ratio * length
    return ObjectSpec(shape, length, width, arm, p.object_height_m)


def draw_placement(rng: np.random.Generator, kind: StepKind, stick: bool, p: WorldParameters = WORLD) -> Placement:
    """A random object at a random place for a step."""
    spec = draw_spec(rng, stick, p)
    x, y = KINDS[kind].spawn(rng, p)
    return Placement(spec, x, y, float(rng.uniform(0, 2 * np.pi)))


def draw_step(rng: np.random.Generator, task: str, step: int, parameters: WorldParameters = WORLD) -> Placement:
    """A random object for one step of a task: a stick where two arms will need one as a tool."""
    steps = TASKS[task]
    stick = step in tool_steps(task) and any(kind.embodiment.two_arms for kind in steps)
    return draw_placement(rng, steps[step], stick, parameters)


def draw_episode(rng: np.random.Generator, task: str, parameters: WorldParameters = WORLD) -> tuple[Placement, ...]:
    """The objects of every step of an episode, in order."""
    return tuple(draw_step(rng, task, step, parameters) for step in range(len(TASKS[task])))
