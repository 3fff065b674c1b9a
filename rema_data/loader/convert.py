"""Fixed-point maps to float32 in metres, bit for bit what ``schema.Observation`` shows a policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.loader.buffers import empty
from rema_data.schema import HEIGHT_STEP_M

__all__ = ["to_metres", "to_metres_cpu", "to_metres_on_device"]

Array = npt.NDArray[Any]
Maps = tuple[Array, Array, Array]

_ROWS = 8
"""Steps converted at a time: what is read and written meanwhile stays in the processor's second cache."""


def to_metres_cpu(read: Callable[[slice], Maps], count: int) -> tuple[Tensor, Tensor]:
    """Scene and end effector of ``count`` steps as in ``FloatBatch``, converted a few at a time.

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
    return torch.from_numpy(scene_m), torch.from_numpy(planes)


def to_metres(scene: Tensor, ee_depth: Tensor, ee_mask: Tensor) -> tuple[Tensor, Tensor]:
    """Maps of a batch on the device where they are; shapes as in ``to_metres_cpu``."""
    if scene.device.type != "cpu":
        return to_metres_on_device(scene, ee_depth, ee_mask)
    arrays = (scene.numpy(), ee_depth.numpy(), ee_mask.numpy())
    return to_metres_cpu(lambda part: (arrays[0][part], arrays[1][part], arrays[2][part]), len(scene))


def to_metres_on_device(scene: Tensor, ee_depth: Tensor, ee_mask: Tensor) -> tuple[Tensor, Tensor]:
    """The same by a device's kernels."""
    planes = torch.empty((len(scene), 4, EE_PIXELS, EE_PIXELS), dtype=torch.float32, device=scene.device)
    planes[:, 0::2] = ee_depth
    planes[:, 0::2] *= HEIGHT_STEP_M
    bits = torch.arange(7, -1, -1, dtype=torch.uint8, device=scene.device)
    planes[:, 1::2] = ((ee_mask.unsqueeze(-1) >> bits) & 1).flatten(-2)
    return scene.to(torch.float32).mul_(HEIGHT_STEP_M).unsqueeze(1), planes
