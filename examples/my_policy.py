"""A policy to start from: find the object in the height map, then grasp it across or push it from behind.

rema check examples/my_policy.py
rema evaluate examples/my_policy.py --task grasp_push --episodes 200
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.policy import ObservationBatch

# A pixel is 4.5 mm. Row i grows with world y, column j with world x. Angle k is the yaw k * 2 pi / 16 of what acts:
# of the axis along which jaws (or two sticks) close. Pushes always run along +x, whatever the angle.
YAWS = np.arange(16) * 2 * np.pi / 16
Array = NDArray[Any]


class Policy:
    def __init__(self, checkpoint: Path | None, device: str) -> None:
        """`checkpoint` is the path given with --checkpoint: load your weights here. This policy has none."""

    def act(self, observations: ObservationBatch) -> NDArray[np.int64]:
        """One action (row i, column j, angle k) for every observation, as integers of shape (N, 3)."""
        choose = self.push if observations.primitive == "push" else self.grasp
        actions = []
        for scene, hand, valid in zip(observations.scene, observations.end_effector, observations.valid, strict=True):
            # Not every action can be reached: `valid[i, j, k]` says which. Take the closest one that can.
            actions.append(nearest(*choose(*object_pixels(scene), hand), valid))
        return np.array(actions)

    def grasp(self, rows: Array, columns: Array, hand: Array) -> tuple[float, float, int]:
        """Close over the centre of the object, across its long axis."""
        _, axes = np.linalg.eigh(np.cov(columns, rows))  # eigenvectors (x, y): the short axis first
        across = np.arctan2(axes[1, 0], axes[0, 0])
        return rows.mean(), columns.mean(), round(across / YAWS[1]) % 16

    def push(self, rows: Array, columns: Array, hand: Array) -> tuple[float, float, int]:
        """Point whatever may touch the object (fingers or a tool) far ahead, and start right behind the object."""
        y, x = np.argwhere(hand[:, :, 1]).T - 55.5  # mask of state 1 at yaw 0, pixels from the hand's centre
        ahead = np.outer(np.cos(YAWS), x) - np.outer(np.sin(YAWS), y)  # at every angle
        k, tip = np.unravel_index(np.argmax(ahead), ahead.shape)
        aside = np.sin(YAWS[k]) * x[tip] + np.cos(YAWS[k]) * y[tip]
        return rows.mean() - aside, columns.min() - ahead[k, tip] - 2, int(k)


def object_pixels(scene: Array) -> tuple[Array, Array]:
    """Rows and columns of what stands higher than 5 mm; the middle of the map where there is nothing."""
    rows, columns = np.nonzero(scene > 0.005)
    return (rows, columns) if len(rows) > 1 else (np.array([31, 32]), np.array([31, 32]))


def nearest(i: float, j: float, k: int, valid: Array) -> tuple[int, int, int]:
    """The valid action closest to (i, j, k); one angle counts as two pixels."""
    rows, columns, angles = np.nonzero(valid)
    turn = np.abs((angles - k + 8) % 16 - 8)
    turn = np.minimum(turn, 8 - turn) if not valid[:, :, 8:].any() else turn  # two arms: half a turn is no turn
    best = np.argmin((rows - i) ** 2 + (columns - j) ** 2 + (2 * turn) ** 2)
    return rows[best], columns[best], angles[best]
