"""The training dataset: a selection of steps, gathered a whole batch at a time from the decoded cache."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import Dataset

from rema_data.errors import InputError
from rema_data.loader import transport as transport
from rema_data.loader.batch import FloatBatch, StepBatch
from rema_data.loader.cache import DecodedCache, MapArrays
from rema_data.loader.convert import to_metres_cpu
from rema_data.loader.index import to_frame
from rema_data.positions import mark_table, refuse_foreign

if TYPE_CHECKING:
    import pandas as pd

    from rema_data.loader.resident import ResidentDataset

__all__ = ["Delivery", "Rows", "StepDataset"]

Delivery = Literal["quantised", "float32"]
Array = npt.NDArray[Any]
Indices = Sequence[int] | Array | Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What a batch is gathered by, one entry a step of the dataset."""

    scene: Array  # int64 (N,): rows of the scene maps in the decoded cache
    ee: Array  # int64 (N,): rows of the end-effector maps
    action: Array  # int64 (N,)
    success: Array  # bool (N,)
    position: Array  # int64 (N,): 0, 1, 2, ...


class StepDataset(Dataset[StepBatch | FloatBatch]):
    """Steps of a release for training; ``Release.steps`` makes one.

    It may be forked, pickled and sent to spawned workers: every process maps the decoded files for itself.
    """

    def __init__(self, cache: DecodedCache, selected: Array, identity: str, maps: Delivery = "quantised") -> None:
        if maps not in ("quantised", "float32"):
            raise InputError(f"maps={maps!r} is unknown", hint="use maps='quantised' or maps='float32'")
        self.delivery: Delivery = maps
        self._cache = cache
        self._selected = selected
        self._identity = identity
        index = cache.index[selected]
        self.rows = Rows(
            index["scene_row"].astype(np.int64),
            index["ee_row"].astype(np.int64),
            index["action"].astype(np.int64),
            np.ascontiguousarray(index["success"]),
            np.arange(len(selected)),
        )

    @cached_property
    def fingerprint(self) -> str:
        """Identity of the release and of the selection, 32 hexadecimal digits: equal for equal tables."""
        return hashlib.sha256(self._identity.encode()).hexdigest()[:32]

    @property
    def maps(self) -> MapArrays:
        """The decoded maps of the release; ``rows`` points into them."""
        return self._cache.maps

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a step, in the order of the dataset: task, round, split, episode, step, last, skill, success, ..."""
        return mark_table(to_frame(self._cache.index[self._selected], self._cache.categories), self.fingerprint)

    def __len__(self) -> int:
        return len(self._selected)

    def __getitem__(self, which: int | slice | Indices) -> StepBatch | FloatBatch:
        """Some steps as a batch: of one step for an integer."""
        return self.__getitems__(self.positions(which))

    def __getitems__(self, indices: Indices) -> StepBatch | FloatBatch:
        """The steps at some positions, in that order, as one batch.

        Raises
        ------
        IndexError
            A position is outside of the dataset.
        InputError
            A single position instead of several, or positions that a sampler drew from another table.
        """
        position, rows, maps = self.positions_of_batch(indices), self.rows, self.maps
        scene_row, ee_row = rows.scene.take(position), rows.ee.take(position)
        labels = (
            torch.from_numpy(rows.action.take(position)),
            torch.from_numpy(rows.success.take(position)),
            torch.from_numpy(position),
        )
        if self.delivery == "quantised":
            return StepBatch(
                torch.from_numpy(maps.scene.take(scene_row, 0)),
                torch.from_numpy(maps.ee_depth.take(ee_row, 0)),
                torch.from_numpy(maps.ee_mask.take(ee_row, 0)),
                *labels,
            )

        def read(part: slice) -> tuple[Array, Array, Array]:
            ee = ee_row[part]
            return maps.scene.take(scene_row[part], 0), maps.ee_depth.take(ee, 0), maps.ee_mask.take(ee, 0)

        return FloatBatch(*to_metres_cpu(read, len(position)), *labels)

    def positions_of_batch(self, indices: Indices) -> npt.NDArray[np.int64]:
        """As ``positions``, for what a loader asks for: raises InputError where that is one position alone."""
        if np.ndim(indices) == 0:  # type: ignore[arg-type]
            raise InputError(
                f"a batch of positions is expected, not the single {indices!r}",
                hint="hand single positions over as DataLoader(dataset, sampler=..., batch_size=...), "
                "and batches as batch_sampler=...",
            )
        return self.positions(indices)

    def positions(self, which: int | slice | Indices) -> npt.NDArray[np.int64]:
        """Positions as a new array, int64 (N,): negative ones count from the end.

        Raises
        ------
        IndexError
            One is outside of the dataset.
        InputError
            They are not whole numbers, not in one row, or a sampler drew them from another table.
        """
        refuse_foreign(which, self.fingerprint, len(self))
        if isinstance(which, slice):
            return self.rows.position[which].copy()
        given = np.atleast_1d(np.asarray(which))
        if given.dtype.kind not in "iu" and given.size:
            raise InputError(
                f"positions are whole numbers, not {given.dtype}", hint="for a mask use dataset.select(mask)"
            )
        if given.ndim != 1:
            raise InputError(
                f"positions of shape {given.shape} are not one batch",
                hint="hand a sampler of batches over as batch_sampler=sampler",
            )
        try:
            return self.rows.position.take(given.astype(np.int64, copy=False))
        except IndexError:
            raise IndexError(f"a position is outside of the dataset, which has {len(self)} steps") from None

    def select(self, which: slice | Indices) -> StepDataset:
        """Some of the steps as a dataset of their own: by position, or by one truth value a step."""
        if not isinstance(which, slice) and (mask := np.asarray(which)).dtype == np.bool_:
            if mask.shape != (len(self),):
                raise InputError(
                    f"a mask of shape {mask.shape} cannot select from {len(self)} steps", hint="give one value a step"
                )
            position = np.flatnonzero(mask)
        else:
            position = self.positions(which)
        picked = hashlib.sha256(position.astype("<i8").tobytes()).hexdigest()
        return StepDataset(self._cache, self._selected[position], f"{self._identity} {picked}", self.delivery)

    def resident(self, device: torch.device | str) -> ResidentDataset:
        """The dataset in the memory of a device, with the same interface; for one process.

        Raises
        ------
        InputError
            The maps do not fit.
        """
        from rema_data.loader.resident import ResidentDataset

        return ResidentDataset(self, device)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "table"}

    def __add__(self, other: Any) -> Any:
        """Refused: in what torch would make of it, positions of the second part are those of the first."""
        raise InputError(
            "datasets of steps cannot be added: each counts its steps for itself",
            hint="select the steps together, for example release.steps(tasks=[...], rounds=[...])",
        )


def identity(manifest_sha256: str, selection: dict[str, Any]) -> str:
    """Text that names a selection from a release."""
    return json.dumps([manifest_sha256, selection], sort_keys=True)
