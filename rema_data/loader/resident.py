"""The training dataset in the memory of a device: batches are picked there, and nothing is copied to it any more."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from rema_data.errors import InputError
from rema_data.loader.batch import FloatBatch, StepBatch
from rema_data.loader.decode import row_bytes

if TYPE_CHECKING:
    import pandas as pd

    from rema_data.loader.dataset import Array, Indices, StepDataset

__all__ = ["ResidentDataset"]

_COPY_BYTES = 64 << 20


class ResidentDataset(Dataset[StepBatch | FloatBatch]):
    """What ``StepDataset.resident`` returns: the same steps, the same batches, on a device.

    For use in one process: ``DataLoader(..., num_workers=0)``, or a loop over the sampler.
    """

    def __init__(self, dataset: StepDataset, device: torch.device | str) -> None:
        self.device = torch.device(device)
        self.delivery = dataset.delivery
        self.fingerprint = dataset.fingerprint
        self._dataset = dataset
        rows = dataset.rows
        scenes, scene = np.unique(rows.scene, return_inverse=True)
        hands, hand = np.unique(rows.ee, return_inverse=True)
        self._fit(len(scenes) * row_bytes("scene") + len(hands) * (row_bytes("ee_depth") + row_bytes("ee_mask")))
        maps = dataset.maps
        self._scene = self._moved(maps.scene, scenes)
        self._ee_depth = self._moved(maps.ee_depth, hands)
        self._ee_mask = self._moved(maps.ee_mask, hands)
        columns = (scene, hand, rows.action, rows.success)
        self._columns = [torch.from_numpy(np.array(column)).to(self.device) for column in columns]

    @property
    def table(self) -> pd.DataFrame:
        """One row a step, as ``StepDataset.table``."""
        return self._dataset.table

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, which: int | slice | Indices) -> StepBatch | FloatBatch:
        """Some steps as a batch on the device: of one step for an integer."""
        return self._gather(self._dataset.positions(which))

    def __getitems__(self, indices: Indices) -> StepBatch | FloatBatch:
        """As ``StepDataset.__getitems__``, on the device."""
        return self._gather(self._dataset.positions_of_batch(indices))

    def _gather(self, position: Array) -> StepBatch | FloatBatch:
        index = torch.from_numpy(position).to(self.device)
        scene, hand, action, success = (column.index_select(0, index) for column in self._columns)
        batch = StepBatch(
            self._scene.index_select(0, scene),
            self._ee_depth.index_select(0, hand),
            self._ee_mask.index_select(0, hand),
            action,
            success,
            index,
        )
        return batch.float() if self.delivery == "float32" else batch

    def _fit(self, needed: int) -> None:
        if self.device.type != "cuda":
            return
        free, _ = torch.cuda.mem_get_info(self.device)
        if needed > free:
            raise InputError(
                f"the maps need {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free on {self.device}",
                hint="choose fewer tasks or rounds, or move single batches: batch.to(device)",
                needed=needed,
                free=free,
            )

    def _moved(self, source: Array, rows: Array) -> Tensor:
        """Some rows of a mapped array on the device, copied in pieces."""
        kind = torch.from_numpy(source[:0].copy()).dtype
        out = torch.empty((len(rows), *source.shape[1:]), dtype=kind, device=self.device)
        step = max(1, _COPY_BYTES // source[0].nbytes)
        for start in range(0, len(rows), step):
            out[start : start + step] = torch.from_numpy(source.take(rows[start : start + step], 0))
        return out
