"""What the policies of `torch_policy.py` and `sklearn_policy.py` look at: the height map around where the hand acts.

A grasp that works, works wherever the object lies and however it is turned. A patch that moves and turns with the hand
says so to any model; from whole maps, a network has to learn it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

Array = NDArray[Any]
POINTS = 13  # a patch has 13 x 13 points, two pixels (9 mm) apart: 11 cm
AHEAD = {"grasp": 0, "push": 10}  # pixels from the hand to the middle of its patch: a push starts behind the object
REACH = {"grasp": 2, "push": 12}  # pixels: further from the object, the hand is not worth asking about
YAWS = 8  # of the 16 angles: turned by half a turn, the bare hand is the same hand


def features(scene: Array, i: Array, j: Array, k: Array, primitive: str) -> Array:
    """Heights (m) of the patch, then the yaw, of actions in one scene (64, 64) or in a scene each (N, 64, 64).

    Returns float32 (N, 171). The patch of a grasp turns with the hand; that of a push looks along +x, where it goes.
    """
    yaw = k * (2 * np.pi / 16)
    turned = yaw[:, None, None] if primitive == "grasp" else 0.0
    aside, along = np.mgrid[:POINTS, :POINTS] * 2 - POINTS + 1
    along = along + AHEAD[primitive]
    rows = np.rint(i[:, None, None] + np.sin(turned) * along + np.cos(turned) * aside).astype(int)
    columns = np.rint(j[:, None, None] + np.cos(turned) * along - np.sin(turned) * aside).astype(int)
    outside = (rows < 0) | (rows > 63) | (columns < 0) | (columns > 63)
    which = (np.arange(len(k))[:, None, None],) if scene.ndim == 3 else ()
    heights = np.where(outside, 0, scene[(*which, rows.clip(0, 63), columns.clip(0, 63))])
    return np.column_stack([heights.reshape(len(k), -1), np.cos(2 * yaw), np.sin(2 * yaw)]).astype(np.float32)


def mirrored(features: Array) -> Array:
    """The same actions in the mirror image of the world in y, which is as good an example."""
    patch, cosine, sine = np.split(features, [-2, -1], axis=1)
    return np.hstack([patch.reshape(-1, POINTS, POINTS)[:, ::-1].reshape(len(patch), -1), cosine, -sine])


def candidates(scene: Array, valid: Array, primitive: str) -> tuple[Array, Array, Array]:
    """Rows, columns and angles of the valid actions near something; all valid ones where the map is empty."""
    near = valid & (distance_transform_edt(scene < 0.005) <= REACH[primitive])[:, :, None]
    i, j, k = np.nonzero((near if near.any() else valid)[:, :, :YAWS])
    return i, j, k
