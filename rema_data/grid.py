"""Metres, pixels and the two-byte action: the one place where they are converted.

World frame: metres, z up, origin at the centre of the workspace, +x the push direction. Row ``i`` grows with world y,
column ``j`` with world x. All functions take scalars or arrays.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

PIXEL_M = 0.0045
"""Edge of one map pixel, metres (paper, Table 1)."""
SCENE_PIXELS = 64
EE_PIXELS = 112
ANGLES = 16
"""Number of action angles K; angle k is the yaw k * 2 pi / 16."""
PAIR_ANGLES = 8
"""Angles 0..7 are allowed when two arms act as one: arms must not cross (paper, section 4.2)."""
VALID_MARGIN = 4
"""Border pixels that are seen but cannot be acted on: the valid square is 56 x 56 pixels, 0.252 m."""
ACTIONS = SCENE_PIXELS * SCENE_PIXELS * ANGLES
"""65,536: every action is one ``uint16``."""
SCENE_HALF_M = SCENE_PIXELS * PIXEL_M / 2
EE_HALF_M = EE_PIXELS * PIXEL_M / 2

Array = npt.NDArray[Any]


@cache
def pixel_centres(pixels: int) -> Array:
    """Pixel centres of a square map along one axis, from its middle, float64 (pixels,), metres, read-only."""
    centres: Array = (np.arange(pixels) + 0.5 - pixels / 2) * PIXEL_M
    centres.setflags(write=False)
    return centres


def encode(i: Any, j: Any, k: Any) -> Any:
    """Grid index of the action (row, column, angle): ``(i * 64 + j) * 16 + k``, 0..65535."""
    return (np.asarray(i) * SCENE_PIXELS + np.asarray(j)) * ANGLES + np.asarray(k)


def decode(index: Any) -> tuple[Any, Any, Any]:
    """Row, column and angle of a grid index (int or array)."""
    cell, k = divmod(index, ANGLES)
    i, j = divmod(cell, SCENE_PIXELS)
    return i, j, k


def to_world(index: Any) -> tuple[Any, Any, Any]:
    """World pose (x m, y m, yaw rad) of a grid index: the centre of its pixel."""
    i, j, k = decode(index)
    return (j + 0.5) * PIXEL_M - SCENE_HALF_M, (i + 0.5) * PIXEL_M - SCENE_HALF_M, k * (2 * np.pi / ANGLES)


def snap(x_m: Any, y_m: Any, yaw_rad: Any) -> Any:
    """Nearest grid index inside the valid square to a continuous action."""
    low, high = VALID_MARGIN, SCENE_PIXELS - VALID_MARGIN - 1
    j = np.clip(np.rint((np.asarray(x_m) + SCENE_HALF_M) / PIXEL_M - 0.5).astype(int), low, high)
    i = np.clip(np.rint((np.asarray(y_m) + SCENE_HALF_M) / PIXEL_M - 0.5).astype(int), low, high)
    k = np.rint(np.asarray(yaw_rad) / (2 * np.pi / ANGLES)).astype(int) % ANGLES
    return encode(i, j, k)


@cache
def inside_valid_square() -> Array:
    """Whether a scene pixel may be acted on, bool (64, 64), read-only: the central 56 x 56."""
    inside = np.zeros((SCENE_PIXELS, SCENE_PIXELS), bool)
    inside[VALID_MARGIN:-VALID_MARGIN, VALID_MARGIN:-VALID_MARGIN] = True
    inside.setflags(write=False)
    return inside
