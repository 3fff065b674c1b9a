"""Every row once, in order: for validation, where padding or dropping would distort the result."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.samplers.arguments import rank_and_world, whole
from rema_data.samplers.strata import column_of, table_of

__all__ = ["EvaluationSampler"]


class EvaluationSampler:
    """Batches of consecutive rows, int64 arrays, for ``DataLoader(dataset, batch_sampler=...)``.

    Nothing is padded, dropped or drawn twice. Ranks take consecutive parts of the table, which differ in length by at
    most one row: the number of batches may differ too, so gather results after the loop and not in it.

    Parameters
    ----------
    table : dataset, DataFrame, mapping, or anything with a length
        Row numbers are positions in it.
    batch_size : int
        Rows in a batch; the last one may be shorter.
    rank, world_size : int, optional
        By default those of ``torch.distributed`` where it is initialised, else 0 and 1.

    Raises
    ------
    InputError
        An argument cannot be used.
    """

    def __init__(
        self, table: Any, batch_size: int = 256, *, rank: int | None = None, world_size: int | None = None
    ) -> None:
        self.batch_size = whole("batch_size", batch_size, 1)
        self.rank, self.world_size = rank_and_world(rank, world_size)
        rows = _length(table)
        self.start, self.stop = (rows * part // self.world_size for part in (self.rank, self.rank + 1))

    def __len__(self) -> int:
        """Batches of this rank."""
        return -(-(self.stop - self.start) // self.batch_size)

    def __iter__(self) -> Iterator[npt.NDArray[np.int64]]:
        for start in range(self.start, self.stop, self.batch_size):
            yield np.arange(start, min(start + self.batch_size, self.stop), dtype=np.int64)


def _length(source: Any) -> int:
    if hasattr(source, "table") or hasattr(source, "columns") or hasattr(source, "keys"):
        table = table_of(source)
        names = list(table) if hasattr(table, "keys") else list(table.columns)
        return len(column_of(table, names[0])) if names else 0
    if isinstance(source, Sized):
        return len(source)
    raise InputError(f"a {type(source).__name__} has no length", hint="pass a dataset or a table")
