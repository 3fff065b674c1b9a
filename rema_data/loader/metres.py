"""Fixed-point maps to float32 in metres, bit for bit what ``schema.Observation`` shows a policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.loader.buffers import empty
from rema_data.schema import HEIGHT_STEP_M

__all__ = ["to_metres"]

Array = npt.NDArray[Any]
Maps = tuple[Array, Array, Array]

_ROWS = 8
"""Steps converted at a time: what is read and written meanwhile stays in the processor's second cache."""


def to_metres(read: Callable[[slice], Maps], count: int) -> tuple[Array, Array]:
    """Scene and end effector of ``count`` steps as in ``FloatArrays``, converted a few at a time.

    ``read`` gives scene, end-effector depth and packed mask of a range of the steps, quantised.
    """
    scene_m = empty((count, 1, SCENE_PIXELS, SCENE_PIXELS), np.float32)
    planes = empty((count, 4, EE_PIXELS, EE_PIXELS), np.float32)
    step = np.float32(HEIGHT_STEP_M)
    for start in range(0, count, _ROWS):
        part = slice(start, start + _ROWS)
        scene, depth, mask = read(part)
        np.multiply(scene, step, out=scene_m[part, 0])
        np.multiply(depth, step, out=planes[part, 0::2])
        planes[part, 1::2] = np.unpackbits(mask).reshape(depth.shape)
    return scene_m, planes
