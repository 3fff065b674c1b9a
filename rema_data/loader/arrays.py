"""Steps as numpy arrays: what a batch holds, without torch.

The records are named tuples, so that JAX, Grain and other libraries that walk nested containers take them as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rema_data.loader.metres import to_metres

if TYPE_CHECKING:
    from rema_data.loader.cache import MapArrays
    from rema_data.loader.dataset import Indices, StepDataset

__all__ = ["ArrayView", "FloatArrays", "Rows", "StepArrays", "gather", "gather_metres"]

Array = npt.NDArray[Any]
Positions = npt.NDArray[np.int64]


class StepArrays(NamedTuple):
    """N steps, quantised; ``StepBatch`` has the same as tensors. ``len`` is that of a tuple: use ``len(x.action)``."""

    scene: Array  # int16 (N, 64, 64): height above the table in 0.1 mm
    ee_depth: Array  # int16 (N, 2, 112, 112): height above the end effector's lowest allowed point in 0.1 mm
    ee_mask: Array  # uint8 (N, 2, 112, 14): eight pixels of a row in a byte, the first in the highest bit
    action: Array  # int64 (N,): grid index
    success: Array  # bool (N,)
    index: Array  # type: ignore[assignment]  # int64 (N,): rows in the dataset's table

    def float(self) -> FloatArrays:
        """The same steps in metres; of a single step without the first axis, too."""
        if np.ndim(self.action) == 0:
            return FloatArrays(*(column[0] for column in StepArrays(*(np.asarray(one)[None] for one in self)).float()))
        maps = to_metres(lambda part: (self.scene[part], self.ee_depth[part], self.ee_mask[part]), len(self.scene))
        return FloatArrays(*maps, self.action, self.success, self.index)


class FloatArrays(NamedTuple):
    """N steps in metres; ``FloatBatch`` has the same as tensors. ``len`` is that of a tuple: use ``len(x.action)``."""

    scene: Array  # float32 (N, 1, 64, 64): metres above the table
    end_effector: Array  # float32 (N, 4, 112, 112): depth (m) and mask of state 1, depth and mask of state 2
    action: Array  # int64 (N,): grid index
    success: Array  # bool (N,)
    index: Array  # type: ignore[assignment]  # int64 (N,): rows in the dataset's table

    def float(self) -> FloatArrays:
        """The batch itself, so that a training loop takes both kinds."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What a batch is gathered by, one entry a step of the dataset."""

    scene: Array  # int64 (N,): rows of the scene maps in the decoded cache
    ee: Array  # int64 (N,): rows of the end-effector maps
    action: Array  # int64 (N,)
    success: Array  # bool (N,)
    position: Array  # int64 (N,): 0, 1, 2, ...


def gather(rows: Rows, maps: MapArrays, position: Positions) -> StepArrays:
    """Steps at some positions, copied out of the decoded maps."""
    ee_row = rows.ee.take(position)
    return StepArrays(
        maps.scene.take(rows.scene.take(position), 0),
        maps.ee_depth.take(ee_row, 0),
        maps.ee_mask.take(ee_row, 0),
        rows.action.take(position),
        rows.success.take(position),
        position,
    )


def gather_metres(rows: Rows, maps: MapArrays, position: Positions) -> FloatArrays:
    """The same in metres, without a quantised batch in between."""
    scene_row, ee_row = rows.scene.take(position), rows.ee.take(position)

    def read(part: slice) -> tuple[Array, Array, Array]:
        ee = ee_row[part]
        return maps.scene.take(scene_row[part], 0), maps.ee_depth.take(ee, 0), maps.ee_mask.take(ee, 0)

    scene_m, planes = to_metres(read, len(position))
    return FloatArrays(scene_m, planes, rows.action.take(position), rows.success.take(position), position)


class ArrayView:
    """The steps of a dataset as numpy arrays, indexed as numpy indexes: ``StepDataset.arrays`` makes one.

    A random-access source for Grain and other loaders. It may be pickled, and sent to worker processes.
    """

    def __init__(self, dataset: StepDataset) -> None:
        self._dataset = dataset

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, which: int | slice | Indices) -> StepArrays | FloatArrays:
        """Some steps; one step without the first axis for an integer. Raises as ``StepDataset.positions`` does."""
        found = self._dataset.gather(self._dataset.positions(which))
        one = not isinstance(which, slice) and np.ndim(which) == 0  # type: ignore[arg-type]
        return type(found)(*(column[0] for column in found)) if one else found
