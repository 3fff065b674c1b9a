"""Small observations for the tests of policies."""

from __future__ import annotations

import numpy as np

from evaluator.policy.contract import ObservationBatch
from rema_data import grid
from rema_data.schema import ObjectSpec, Placement, Shape, Situation


def make_batch(count: int, task: str = "grasp", seed: int = 0, primitive: str | None = None) -> ObservationBatch:
    """``count`` different observations: one box a scene, a plain end effector, the central square at every angle."""
    generator = np.random.default_rng(seed)
    scene = np.zeros((count, grid.SCENE_PIXELS, grid.SCENE_PIXELS), np.float32)
    for n in range(count):
        i, j = generator.integers(12, 44, 2)
        scene[n, i : i + 5, j : j + 12] = 0.03
        scene[n, 0, 0] = n * np.float32(1e-4)
    end_effector = np.zeros((count, grid.EE_PIXELS, grid.EE_PIXELS, 4), np.float32)
    end_effector[:, 50:60, 40:44, 1] = 1
    valid = np.broadcast_to(grid.inside_valid_square()[:, :, None], (grid.SCENE_PIXELS, grid.SCENE_PIXELS, grid.ANGLES))
    return ObservationBatch(
        scene,
        end_effector,
        primitive or ("push" if task == "push" else "grasp"),
        "gripper",
        task,
        0,
        np.repeat(valid[None], count, axis=0),
    )


def make_situation(x_m: float = 0.02, y_m: float = -0.03, task: str = "grasp") -> Situation:
    """An I on the table."""
    spec = ObjectSpec(Shape.I, 0.1, 0.03, 0.0, 0.03)
    return Situation(task, 0, Placement(spec, x_m, y_m, 0.3))
