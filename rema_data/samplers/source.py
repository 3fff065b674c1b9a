"""What a sampler is given: a dataset, some of one, or a bare table."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rema_data.errors import InputError
from rema_data.positions import refuse_changed_rows

__all__ = ["Source", "source_of"]


@dataclass(frozen=True, eq=False)
class Source:
    """A table, and the dataset that its row numbers count in."""

    table: Any  # DataFrame, or mapping of columns
    fingerprint: str | None  # of the dataset; None for a bare table


def source_of(given: Any) -> Source:
    """Table and identity of a dataset with a ``table``, of a torch ``Subset`` of one, or of a bare table.

    Raises
    ------
    InputError
        Something else, a ``ConcatDataset``, or a table of a dataset whose rows were picked or sorted.
    """
    torch_data = sys.modules.get("torch.utils.data")  # who has such a dataset has imported it
    if torch_data is not None and isinstance(given, torch_data.Subset):
        return _part(source_of(given.dataset), np.asarray(given.indices, np.int64))
    if torch_data is not None and isinstance(given, torch_data.ConcatDataset):
        raise InputError(
            "a ConcatDataset has no table: its parts count their steps each for itself",
            hint="select the steps together, for example release.steps(tasks=[...], rounds=[...])",
        )
    table = getattr(given, "table", given)
    if not (isinstance(table, Mapping) or hasattr(table, "columns")):
        raise InputError(
            f"a {type(given).__name__} is not a table",
            hint="pass a dataset of `release.steps(...)`, a pandas DataFrame, or a mapping of column names to arrays",
        )
    refuse_changed_rows(table)
    fingerprint = getattr(given, "fingerprint", None)
    return Source(table, fingerprint if isinstance(fingerprint, str) else None)


def _part(whole: Source, rows: Any) -> Source:
    """Some rows of a source."""
    if isinstance(whole.table, Mapping):
        table: Any = {name: np.asarray(column)[rows] for name, column in whole.table.items()}
    else:
        table = whole.table.iloc[rows].reset_index(drop=True)
        table.attrs.clear()  # the rows of the part get new numbers
    digest = hashlib.sha256(f"{whole.fingerprint} {rows.astype('<i8').tobytes().hex()}".encode())
    return Source(table, None if whole.fingerprint is None else digest.hexdigest()[:32])
