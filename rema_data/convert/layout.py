"""Episodes as arrays: observations, actions, rewards and dones, and columns.

What readers want besides (actions, rewards, dones, grid index) follows from the columns of ``steps.parquet``;
observations and columns can be turned back without loss. Observations have their channels last, as robomimic expects,
or as planes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rema_data.convert.base import Maps
from rema_data.errors import InputError, IntegrityError
from rema_data.grid import SCENE_HALF_M
from rema_data.heights import dequantise, pack_mask, quantise, unpack_mask
from rema_data.store.columns import Column

__all__ = [
    "INSTRUCTIONS",
    "from_array",
    "obs_dtype",
    "obs_of_end_effectors",
    "obs_of_scenes",
    "planes_of_end_effectors",
    "stored_end_effectors",
    "stored_scenes",
    "to_array",
    "trajectory",
]

Array = npt.NDArray[Any]
INSTRUCTIONS = {
    "grasp": "Grasp the object and lift it.",
    "push": "Push the object forward with the closed gripper.",
    "grasp_grasp": "Pick up two sticks, then grasp the object between them and lift it.",
    "grasp_push": "Pick up the tool, then push the object forward with it.",
    "grasp_grasp_push": "Pick up two sticks, pinch an object between them, then push another object forward with it.",
}
"""What a task asks for, in a sentence, for formats whose policies read one. Forward is +x."""

_STRINGS = "S"
_HIGHEST = np.iinfo(np.int16).max


def obs_dtype(maps: Maps) -> str:
    """Type of the observations of an export."""
    return "float32" if maps == "metres" else "uint16"


def obs_of_scenes(scene: Array, maps: Maps) -> Array:
    """Observation (N, 64, 64, 1) of stored scene maps (N, 64, 64)."""
    return (dequantise(scene) if maps == "metres" else scene)[..., None]


def planes_of_end_effectors(depth: Array, mask: Array, maps: Maps) -> Array:
    """Planes (N, 4, 112, 112) of stored end-effector maps: depth, mask of state 1, depth, mask of state 2."""
    planes = np.empty((len(depth), 4, *depth.shape[2:]), obs_dtype(maps))
    planes[:, 0::2] = dequantise(depth) if maps == "metres" else depth
    planes[:, 1::2] = unpack_mask(mask)
    return planes


def obs_of_end_effectors(depth: Array, mask: Array, maps: Maps) -> Array:
    """Observation (N, 112, 112, 4) of stored end-effector maps: their planes, last."""
    return np.ascontiguousarray(np.moveaxis(planes_of_end_effectors(depth, mask, maps), 1, -1))


def _stored_heights(obs: Array) -> Array:
    stored = np.ascontiguousarray(obs if obs.dtype == np.uint16 else quantise(obs))
    if stored.size and stored.max() > _HIGHEST:
        raise InputError("a height is missing, or above what a reader accepts (3.26 m)", hint="fix the map")
    return stored


def stored_scenes(obs: Array) -> Array:
    """Inverse of ``obs_of_scenes``; raises InputError where a height cannot be stored."""
    return _stored_heights(obs[..., 0])


def stored_end_effectors(obs: Array) -> tuple[Array, Array]:
    """Inverse of ``obs_of_end_effectors``: depth uint16 (N, 2, 112, 112) and mask uint8 (N, 2, 112, 14).

    Raises InputError where a height cannot be stored, or a mask is neither 0 nor 1.
    """
    masks = np.moveaxis(obs[..., 1::2], -1, 1)
    allowed = masks == 1
    if not (allowed | (masks == 0)).all():
        raise InputError("a mask holds values other than 0 and 1", hint="fix the map")
    return _stored_heights(np.moveaxis(obs[..., 0::2], -1, 1)), pack_mask(allowed)


def trajectory(steps: pa.Table) -> dict[str, Array]:
    """What readers want besides the observations, one row a step of one or more whole episodes.

    ``actions`` float32 (N, 4) in [-1, 1]: x and y of the hand over half the width of the scene map (0.144 m), cosine
    and sine of its yaw. ``rewards`` float32 (N,): 1 where the task was accomplished. ``dones`` int64 (N,): 1 at the end
    of an episode. ``grid_index`` int64 (N,): the action on the grid.
    """
    theta = steps["theta_rad"].to_numpy()
    x, y = (steps[name].to_numpy() / SCENE_HALF_M for name in ("x_m", "y_m"))
    success, last = (steps[name].to_numpy(zero_copy_only=False) for name in ("success", "last"))
    return {
        "actions": np.stack([x, y, np.cos(theta), np.sin(theta)], axis=1).astype(np.float32),
        "rewards": (success & last).astype(np.float32),
        "dones": (last | ~success).astype(np.int64),
        "grid_index": steps["action"].to_numpy().astype(np.int64),
    }


def to_array(values: pa.ChunkedArray, column: Column) -> Array:
    """A column as a numpy array. What is null becomes NaN or an empty string; text becomes UTF-8 of fixed width.

    Raises IntegrityError where a value that is not null looks like one that is.
    """
    if column.nullable:
        blank = pc.equal(values, "") if column.type == "string" else pc.is_nan(values)
        if pc.any(blank).as_py():
            raise IntegrityError(
                f"column {column.name} holds a value that stands for null",
                hint="find the damaged file: `rema verify`, with the name or the folder of the release",
                column=column.name,
            )
    if column.type != "string":
        array: Array = values.to_numpy(zero_copy_only=False)
        return array
    texts = [text.encode() for text in pc.fill_null(values, "").to_pylist()]
    return np.array(texts, f"{_STRINGS}{max([1, *map(len, texts)])}")


def from_array(array: Array, column: Column) -> pa.Array:
    """Inverse of ``to_array``; raises IntegrityError where type or shape are not those of the column."""
    kind = pa.type_for_alias(column.type)
    try:
        if array.ndim != 1:
            raise ValueError(f"it has the shape {array.shape}")
        if column.type == "string":
            if array.dtype.kind != _STRINGS:
                raise ValueError(f"it holds {array.dtype}")
            texts = [text.decode() for text in array.tolist()]
            return pa.array([text or None for text in texts] if column.nullable else texts, kind)
        if array.dtype != kind.to_pandas_dtype():
            raise ValueError(f"it holds {array.dtype}")
        return pa.array(array, kind, mask=np.isnan(array) if column.nullable else None)
    except ValueError as error:
        raise IntegrityError(
            f"column {column.name} cannot be used: {error}", hint="export the release again", column=column.name
        ) from error
