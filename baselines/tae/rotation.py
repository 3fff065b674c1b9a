"""End-effector maps, turned: captured at yaw 0, and shown to the network at the yaw that is asked about."""

from __future__ import annotations

import math
from functools import cache

import torch
from torch import Tensor
from torch.nn import functional

from rema_data.grid import ANGLES, EE_PIXELS

__all__ = ["turn_end_effector"]


def turn_end_effector(end_effector: Tensor, k: Tensor) -> Tensor:
    """Every map turned about its centre by its own angle, from +x to +y.

    Parameters
    ----------
    end_effector : float (N, C, 112, 112)
        At yaw 0.
    k : int64 (N,)
        Angles of the action grid: yaw k * 2 pi / 16.

    Returns
    -------
    float (N, C, 112, 112)
        Bilinear between pixels; 0 where the source lies outside of the map. Corners that leave the square are lost.
    """
    grids = _grids(end_effector.device)[k]
    return functional.grid_sample(end_effector, grids, mode="bilinear", padding_mode="zeros", align_corners=False)


@cache
def _grids(device: torch.device) -> Tensor:
    """Where each pixel of a turned map comes from, float32 (16, 112, 112, 2), in the coordinates of ``grid_sample``."""
    rows = []
    for k in range(ANGLES):
        # round() makes quarter turns exact
        cosine, sine = (round(f(2 * math.pi * k / ANGLES), 15) for f in (math.cos, math.sin))
        rows.append([[cosine, sine, 0.0], [-sine, cosine, 0.0]])
    matrices = torch.tensor(rows, dtype=torch.float64)
    grids = functional.affine_grid(matrices, [ANGLES, 1, EE_PIXELS, EE_PIXELS], align_corners=False)
    return grids.to(device, torch.float32)
