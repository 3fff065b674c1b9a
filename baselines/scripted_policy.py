"""The paper's scripted baseline: the true position of the target, a uniform angle. Privileged."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from baselines.observation_hash import observation_number
from evaluator.policy.interface import ObservationBatch
from evaluator.sim.parameters import WORLD
from rema_data import grid
from rema_data.schema import Primitive, Situation

__all__ = ["ScriptedPolicy"]


class ScriptedPolicy:
    """Grasps at the target's centre of mass, pushes from a constant offset behind it; angles are uniform.

    Parameters
    ----------
    checkpoint : Path or None
        Not used.
    device : str
        Not used.
    """

    privileged: ClassVar[bool] = True

    def __init__(self, checkpoint: Path | None = None, device: str = "cpu") -> None:
        pass

    def act(self, observations: ObservationBatch, situations: tuple[Situation, ...]) -> npt.NDArray[np.int64]:
        """Grid indices, int64 (N,)."""
        offset_m = WORLD.scripted_push_offset_m if observations.primitive == Primitive.PUSH else 0.0
        actions = np.empty(len(observations), np.int64)
        for n, situation in enumerate(situations):
            valid = observations.valid[n]
            # 16 angles for one arm, 8 for two: the angles that `valid` allows somewhere.
            angles = np.flatnonzero(valid.any(axis=(0, 1)))
            k = int(angles[observation_number(observations, n) % len(angles)])
            wanted = grid.snap(situation.target.x_m - offset_m, situation.target.y_m, k * 2 * np.pi / grid.ANGLES)
            i, j, k = (int(part) for part in grid.decode(wanted))
            actions[n] = grid.encode(*nearest_valid(valid, i, j, k))
        return actions


def nearest_valid(valid: npt.NDArray[np.bool_], i: int, j: int, k: int) -> tuple[int, int, int]:
    """The valid action with angle ``k`` whose pixel is nearest to (i, j); ties go to the lowest grid index.

    Parameters
    ----------
    valid : bool (64, 64, 16)
        With at least one valid pixel for this angle.
    """
    if valid[i, j, k]:
        return i, j, k
    rows, columns = np.nonzero(valid[:, :, k])
    best = int(np.argmin((rows - i) ** 2 + (columns - j) ** 2))  # rows are sorted, and argmin takes the first
    return int(rows[best]), int(columns[best]), k
