"""Heights as fixed-point numbers: the canonical bits of every stored map.

A stored value is ``round((height + 10 mm) / 0.1 mm)`` as uint16. The step is coarser than the jitter of a depth buffer,
so equal scenes are equal bytes; the offset keeps small negative heights, which clipping at zero would bias; 65535 is
never a height, so that a hole in a file cannot pass for a flat table. The error is at most half a step: 0.05 mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError, IntegrityError
from rema_data.schema import HEIGHT_STEP_M

__all__ = [
    "HEIGHT_ERROR_M",
    "HEIGHT_OFFSET_M",
    "HEIGHT_OFFSET_STEPS",
    "MISSING",
    "decode_heights",
    "dequantise",
    "encode_heights",
    "pack_mask",
    "quantise",
    "unpack_mask",
]

HEIGHT_OFFSET_STEPS = 100
HEIGHT_OFFSET_M = -HEIGHT_OFFSET_STEPS * HEIGHT_STEP_M
"""Height of the stored value 0."""
HEIGHT_ERROR_M = HEIGHT_STEP_M / 2
"""Largest difference between a height and what is stored for it."""
MISSING = 65535
"""A stored value that means: no data here."""

_HIGHEST = np.iinfo(np.int16).max  # of the decoded form
Heights = npt.NDArray[np.uint16]


def quantise(height_m: npt.ArrayLike) -> Heights:
    """Stored values of heights in metres, uint16, of the same shape.

    Raises
    ------
    InputError
        A height is NaN, infinite, below -10 mm or above 3.26 m.
    """
    steps = np.rint(np.asarray(height_m, np.float64) / HEIGHT_STEP_M) + HEIGHT_OFFSET_STEPS
    if not np.all((steps >= 0) & (steps <= _HIGHEST)):  # false for NaN too
        low, high = HEIGHT_OFFSET_M, _HIGHEST * HEIGHT_STEP_M + HEIGHT_OFFSET_M
        raise InputError(
            f"a height is not a number between {low:g} and {high:g} m",
            hint="fix the map: heights are metres above the table",
        )
    return steps.astype(np.uint16)


def dequantise(stored: Heights) -> npt.NDArray[np.float32]:
    """Heights in metres, float32: bit for bit what a policy is shown for the same map.

    Raises
    ------
    IntegrityError
        A value is missing, or higher than int16 can say (3.26 m).
    """
    return decode_heights(stored) * np.float32(HEIGHT_STEP_M)


def encode_heights(steps: npt.NDArray[Any]) -> Heights:
    """Stored values of heights in whole 0.1 mm (as in an ``Observation``); InputError where one is out of range."""
    shifted = np.asarray(steps, np.int32) + HEIGHT_OFFSET_STEPS
    if shifted.size and not 0 <= shifted.min() <= shifted.max() <= _HIGHEST:
        raise InputError("a height is out of the range of the format", hint="heights are units of 0.1 mm, from -100 up")
    return shifted.astype(np.uint16)


def decode_heights(stored: Heights) -> npt.NDArray[np.int16]:
    """Heights as whole numbers of 0.1 mm above the table, int16. Raises IntegrityError as ``dequantise`` does."""
    top = int(stored.max()) if stored.size else 0
    if top > np.iinfo(np.int16).max:
        what = "a value is missing" if top == MISSING else f"the value {top} is not a height"
        raise IntegrityError(
            f"in a height map {what}",
            hint="find the damaged file: `rema verify`, with the name or the folder of the release",
            value=top,
        )
    return stored.view(np.int16) - np.int16(HEIGHT_OFFSET_STEPS)


def pack_mask(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """Eight pixels of a row in one byte, the first in the highest bit: uint8 (..., 112, 14) of bool (..., 112, 112)."""
    return np.packbits(mask, axis=-1)


def unpack_mask(packed: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Inverse of ``pack_mask``."""
    return np.unpackbits(packed, axis=-1).view(np.bool_)
