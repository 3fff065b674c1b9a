"""LeRobot v3: one dataset a task, one frame a step.

::

    grasp_push/
        data/chunk-000/file-000.parquet     the frames of a block, a file a block
        meta/info.json                      features, counts, splits (``train`` before ``val``)
        meta/stats.json                     exact statistics over all frames
        meta/tasks.parquet                  the instruction
        meta/episodes/chunk-000/file-000.parquet
        rema/                               what ``rema import`` needs (``seal``)

Maps are plain array features, planes first: LeRobot would take an integer depth image for millimetres.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from rema_data.convert.folders import FolderFormat, NewDataset
from rema_data.convert.lerobot_features import DATA_PATH, MAPS
from rema_data.convert.lerobot_writer import write_dataset
from rema_data.convert.nested import read_nested
from rema_data.convert.seal import SealedFolder

__all__ = ["Lerobot"]

Array = npt.NDArray[Any]


class Lerobot(FolderFormat):
    """LeRobot's layout, version 3."""

    name: ClassVar[str] = "lerobot"

    def write(self, dataset: NewDataset) -> None:
        """See ``FolderFormat``."""
        write_dataset(dataset)

    def observations(self, dataset: SealedFolder, number: int, steps: int) -> Iterator[tuple[Array, Array]]:
        """See ``FolderFormat``."""
        path = dataset.path / DATA_PATH.format(chunk_index=0, file_index=number)
        for columns in read_nested(path, MAPS, steps):
            scenes, end_effectors = (np.moveaxis(columns[name], 1, -1) for name in MAPS)
            yield scenes, end_effectors
