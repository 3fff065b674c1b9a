"""What a frame of a LeRobot export has, and where its files are."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data.convert.base import Maps
from rema_data.convert.layout import obs_dtype, trajectory
from rema_data.convert.nested import array_feature, feature
from rema_data.grid import EE_PIXELS, SCENE_PIXELS

__all__ = [
    "DATA_PATH",
    "EPISODES_PATH",
    "FPS",
    "LABELS",
    "MAPS",
    "VERSION",
    "features",
    "frames",
    "hugging_face",
]

Array = npt.NDArray[Any]

VERSION = "v3.0"
"""Of LeRobot's layout."""
FPS = 1
"""Frames a second. A step has no duration of its own: its timestamp is its position in the episode."""
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
MAPS = {
    "observation.scene": (1, SCENE_PIXELS, SCENE_PIXELS),
    "observation.end_effector": (4, EE_PIXELS, EE_PIXELS),
}
LABELS = ("primitive", "embodiment", "policy", "failure")
"""Columns of ``steps.parquet`` that are features too; no failure is an empty string."""

_AXES = ["channels", "height", "width"]
_ACTION = ["x", "y", "cos_yaw", "sin_yaw"]
_VECTORS: dict[str, tuple[str, int, list[str] | None]] = {
    "action": ("float32", 4, _ACTION),
    "grid_index": ("int64", 1, None),
    "next.reward": ("float32", 1, None),
    "next.done": ("bool", 1, None),
    "next.success": ("bool", 1, None),
    "timestamp": ("float32", 1, None),
    "frame_index": ("int64", 1, None),
    "episode_index": ("int64", 1, None),
    "index": ("int64", 1, None),
    "task_index": ("int64", 1, None),
}


def features(maps: Maps) -> dict[str, dict[str, Any]]:
    """``features`` of ``meta/info.json``."""
    about: dict[str, dict[str, Any]] = {
        name: {"dtype": obs_dtype(maps), "shape": list(shape), "names": _AXES} for name, shape in MAPS.items()
    }
    about |= {
        name: {"dtype": dtype, "shape": [size], "names": names} for name, (dtype, size, names) in _VECTORS.items()
    }
    return about | {name: {"dtype": "string", "shape": [1], "names": None} for name in LABELS}


def hugging_face(maps: Maps) -> dict[str, Any]:
    """The same features as ``datasets`` describes them."""
    found = {name: array_feature(shape, obs_dtype(maps)) for name, shape in MAPS.items()}
    for name, (dtype, size, _) in _VECTORS.items():
        plain = feature(dtype)
        found[name] = plain if size == 1 else {"feature": plain, "length": size, "_type": "List"}
    return found | {name: feature("string") for name in LABELS}


def frames(steps: pa.Table, first_frame: int, first_episode: int) -> dict[str, Array]:
    """Features of the steps of whole episodes that are numbers and no maps: (N,) or (N, size) arrays."""
    about = trajectory(steps)
    count = steps.num_rows
    position = steps["step"].to_numpy().astype(np.int64)
    columns = {
        "action": about["actions"],
        "grid_index": about["grid_index"],
        "next.reward": about["rewards"],
        "next.done": about["dones"].astype(bool),
        "next.success": about["rewards"] > 0,
        "timestamp": position / FPS,
        "frame_index": position,
        "episode_index": first_episode + np.cumsum(position == 0) - 1,
        "index": first_frame + np.arange(count),
        "task_index": np.zeros(count),
    }
    return {name: columns[name].astype(dtype) for name, (dtype, _, _) in _VECTORS.items()}
