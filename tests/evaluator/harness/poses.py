"""Poses of grid actions, as a policy that was trained on an export gives them."""

from __future__ import annotations

from typing import Any

import numpy as np

from rema_data import grid


def pose_of(action: int) -> Any:
    """Float32 (4,) of a grid index: the ``action`` of an export for LeRobot."""
    x_m, y_m, yaw_rad = grid.to_world(action)
    half = grid.SCENE_HALF_M
    return np.array([x_m / half, y_m / half, np.cos(yaw_rad), np.sin(yaw_rad)], np.float32)
