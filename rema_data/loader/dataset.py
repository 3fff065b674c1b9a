"""The training dataset: a selection of steps, gathered a whole batch at a time from the decoded cache.

Torch is imported when the first batch of tensors is made, and not before: ``arrays`` and ``numpy_batches`` need none.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.loader.arrays import ArrayView, FloatArrays, Rows, StepArrays, gather, gather_metres
from rema_data.loader.cache import DecodedCache, MapArrays
from rema_data.loader.index import to_frame
from rema_data.positions import mark_table, refuse_foreign

if TYPE_CHECKING:
    import pandas as pd
    import torch
    from torch import Tensor
    from torch.utils.data import Dataset

    from rema_data.loader.batch import FloatBatch, StepBatch
    from rema_data.loader.resident import ResidentDataset
    from rema_data.progress import Progress
    from rema_data.statistics.values import ValueStatistics

    Base = Dataset[StepBatch | FloatBatch]
    Indices = Sequence[int] | npt.NDArray[Any] | Tensor
else:
    # Torch's base class has no behaviour that a map-style dataset needs, and deriving from it would import torch.
    Base = object

__all__ = ["Delivery", "Rows", "StepDataset"]

Delivery = Literal["quantised", "float32"]
Array = npt.NDArray[Any]


class StepDataset(Base):
    """Steps of a release for training; ``Release.steps`` makes one. For torch it is a map-style dataset.

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
        from rema_data.loader import transport as transport  # how a worker process sends a batch
        from rema_data.loader.batch import as_batch

        return as_batch(self.gather(self.positions_of_batch(indices)))

    @property
    def arrays(self) -> ArrayView:
        """The steps as numpy arrays: ``dataset.arrays[i]`` is one step, ``dataset.arrays[:8]`` eight."""
        return ArrayView(self)

    def numpy_batches(self, sampler: Iterable[Indices]) -> Iterator[StepArrays | FloatArrays]:
        """The batches of one epoch of a sampler as numpy arrays: the bytes of torch's loader, in its order.

        Nothing is drawn ahead: after a batch, ``sampler.state_dict()`` is the position behind it, and a sampler that
        gets it with ``load_state_dict`` continues with the next batch.

        Parameters
        ----------
        sampler : iterable
            Gives the positions of one batch after another, as a ``BalancedSampler`` does.

        Raises
        ------
        IndexError, InputError
            As for ``__getitems__``, when the batch is asked for.
        """
        for indices in sampler:
            yield self.gather(self.positions_of_batch(indices))

    def gather(self, position: npt.NDArray[np.int64]) -> StepArrays | FloatArrays:
        """Steps at positions that ``positions`` has checked, as arrays of their own."""
        take = gather if self.delivery == "quantised" else gather_metres
        return take(self.rows, self.maps, position)

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

    def statistics(self, progress: Progress | None = None) -> ValueStatistics:
        """Count, mean, deviation, range, 1 % and 99 % of every channel of the maps and every component of the actions.

        They are exact, and of exactly these steps: a map that several steps share counts for each. Heights are in
        metres, whatever ``maps`` a batch holds. A selection is counted once, and then read from the decoded cache.
        """
        from rema_data.statistics.values import read_values, value_statistics, write_values

        folder, rows, maps = self._cache.folder, self.rows, self.maps
        found = None if folder is None else read_values(folder, self.fingerprint)
        if found is None:
            scene, depth, mask = (maps.scene, rows.scene), (maps.ee_depth, rows.ee), (maps.ee_mask, rows.ee)
            found = value_statistics(self.fingerprint, scene, depth, mask, rows.action, progress)
            if folder is not None:
                write_values(folder, found)
        return found

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
