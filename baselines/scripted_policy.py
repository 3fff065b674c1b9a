"""The paper's scripted baseline: the true position of the target, a uniform angle. Privileged."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from baselines.observation_hash import observation_numbers
from evaluator.policy.contract import ObservationBatch
from evaluator.sim.kinds import KINDS
from rema_data import grid
from rema_data.schema import Embodiment, Primitive, Situation, StepKind

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
        angles = np.array(
            [_angle(*pair) for pair in zip(observations.valid, observation_numbers(observations), strict=True)]
        )
        kind = KINDS[StepKind(Primitive(observations.primitive), Embodiment(observations.embodiment))]
        aims = np.array([kind.aim(situation.target) for situation in situations]).reshape(-1, 2)
        rows, columns, _ = grid.decode(grid.snap(aims[:, 0], aims[:, 1], angles * (2 * np.pi / grid.ANGLES)))
        cells = zip(observations.valid, rows.tolist(), columns.tolist(), angles.tolist(), strict=True)
        return np.array([grid.encode(*nearest_valid(*cell)) for cell in cells], np.int64)


def _angle(valid: npt.NDArray[np.bool_], number: int) -> int:
    """One of the angles that can be reached somewhere, each equally likely: 16 with one arm, 8 with two."""
    allowed = np.flatnonzero(valid.reshape(-1, grid.ANGLES).any(axis=0))
    return int(allowed[number % len(allowed)])


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
