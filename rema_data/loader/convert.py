"""Tensors of fixed-point maps to float32 in metres: bit for bit what ``rema_data.loader.metres`` makes of arrays."""

from __future__ import annotations

import torch
from torch import Tensor

from rema_data.grid import EE_PIXELS
from rema_data.loader.metres import to_metres as arrays_to_metres
from rema_data.schema import HEIGHT_STEP_M

__all__ = ["to_metres", "to_metres_on_device"]


def to_metres(scene: Tensor, ee_depth: Tensor, ee_mask: Tensor) -> tuple[Tensor, Tensor]:
    """Maps of a batch on the device where they are; shapes as in ``FloatBatch``."""
    if scene.device.type != "cpu":
        return to_metres_on_device(scene, ee_depth, ee_mask)
    arrays = (scene.numpy(), ee_depth.numpy(), ee_mask.numpy())
    scene_m, planes = arrays_to_metres(lambda part: (arrays[0][part], arrays[1][part], arrays[2][part]), len(scene))
    return torch.from_numpy(scene_m), torch.from_numpy(planes)


def to_metres_on_device(scene: Tensor, ee_depth: Tensor, ee_mask: Tensor) -> tuple[Tensor, Tensor]:
    """The same by a device's kernels."""
    planes = torch.empty((len(scene), 4, EE_PIXELS, EE_PIXELS), dtype=torch.float32, device=scene.device)
    planes[:, 0::2] = ee_depth
    planes[:, 0::2] *= HEIGHT_STEP_M
    bits = torch.arange(7, -1, -1, dtype=torch.uint8, device=scene.device)
    planes[:, 1::2] = ((ee_mask.unsqueeze(-1) >> bits) & 1).flatten(-2)
    return scene.to(torch.float32).mul_(HEIGHT_STEP_M).unsqueeze(1), planes
