"""A policy to start from: look at the height map, find the object, act on its middle. Score it with

rema evaluate examples/my_policy.py --task grasp_push --episodes 200
"""

import numpy as np

PIXEL_M = 0.0045  # edge of a pixel; row i grows with world y, column j with world x
FULL_TURN = 16  # angle k is the yaw k * 2 pi / 16 of the hand: of the axis along which its jaws close


class Policy:
    def __init__(self, checkpoint, device):
        """`checkpoint` is the path given with --checkpoint: load your weights here. This policy has none."""

    def act(self, observations):
        """One action (row i, column j, angle k) for every observation, as integers of shape (N, 3)."""
        choose = self.push if observations.primitive == "push" else self.grasp
        wanted = [choose(scene) for scene in observations.scene]
        # Not every action can be reached: `valid[n, i, j, k]` says which. Take the closest one that can.
        return np.array([nearest(*action, valid) for action, valid in zip(wanted, observations.valid, strict=True)])

    def grasp(self, scene):
        """Close the jaws over the centre of the object, across its long axis."""
        rows, columns = np.nonzero(scene > 0.005)  # whatever stands higher than 5 mm is the object
        _, axes = np.linalg.eigh(np.cov(columns, rows))  # eigenvectors (x, y): the short axis first
        across = np.arctan2(axes[1, 0], axes[0, 0])
        return rows.mean(), columns.mean(), round(across / (2 * np.pi) * FULL_TURN) % FULL_TURN

    def push(self, scene):
        """Pushes run along +x, which is along the columns: start 10 cm before the centre of the object."""
        rows, columns = np.nonzero(scene > 0.005)
        return rows.mean(), columns.mean() - 0.10 / PIXEL_M, 0


def nearest(i, j, k, valid):
    """The valid action closest to (i, j, k); an angle step counts as much as two pixels, half a turn as nothing."""
    rows, columns, angles = np.nonzero(valid)
    turn = np.abs((angles - k + 4) % 8 - 4)
    best = np.argmin((rows - i) ** 2 + (columns - j) ** 2 + (2 * turn) ** 2)
    return rows[best], columns[best], angles[best]
