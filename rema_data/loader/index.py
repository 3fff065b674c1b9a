"""The training columns of every local step: one structured array, so that a table opens in a millisecond.

Text columns are codes into ``CATEGORIES`` or into the values that the release holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

__all__ = ["HIDDEN", "INDEX_DTYPE", "TEXT_COLUMNS", "Categories", "Index", "encode_steps", "to_frame"]

Index = npt.NDArray[np.void]
"""Structured array of ``INDEX_DTYPE``, one row a step."""
Categories = Mapping[str, Sequence[str]]
"""Values of every text column; the code -1 is null."""

_TEXT = np.int16
INDEX_DTYPE = np.dtype(
    [
        ("task", _TEXT),
        ("round", np.int16),
        ("split", _TEXT),
        ("episode", np.int32),
        ("step", np.int8),
        ("last", np.bool_),
        ("skill", _TEXT),
        ("primitive", _TEXT),
        ("embodiment", _TEXT),
        ("policy", _TEXT),
        ("arm", _TEXT),
        ("action", np.uint16),
        ("success", np.bool_),
        ("failure", _TEXT),
        ("scene_row", np.int32),
        ("ee_row", np.int32),
    ]
)
"""Columns of ``steps.parquet`` that training and selection need. The two rows count within the decoded cache."""

TEXT_COLUMNS = ("task", "split", "skill", "primitive", "embodiment", "policy", "arm", "failure")
HIDDEN = ("scene_row", "ee_row")
"""Columns that mean something only together with the cache."""


def encode_steps(tables: Sequence[pa.Table]) -> tuple[Index, dict[str, list[str]]]:
    """Index of some step tables in a row, whose map rows still count within their blocks, and its text values."""
    import pyarrow as pa
    import pyarrow.compute as pc

    steps = pa.concat_tables([table.select(list(INDEX_DTYPE.names or ())) for table in tables])
    index = np.empty(steps.num_rows, INDEX_DTYPE)
    categories: dict[str, list[str]] = {}
    for name in INDEX_DTYPE.names or ():
        column = steps.column(name)
        if name in TEXT_COLUMNS:
            coded = column.combine_chunks().dictionary_encode()
            categories[name] = coded.dictionary.to_pylist()
            index[name] = pc.fill_null(coded.indices, -1).to_numpy(zero_copy_only=False)
        else:
            index[name] = column.to_numpy()
    return index, categories


def to_frame(index: Index, categories: Categories) -> pd.DataFrame:
    """Index as a DataFrame with a fresh RangeIndex; text columns are categorical, with the values that occur."""
    import pandas as pd

    columns: dict[str, Any] = {}
    for name in index.dtype.names or ():
        if name in HIDDEN:
            continue
        values: npt.NDArray[np.integer[Any]] = np.ascontiguousarray(index[name])
        if name in TEXT_COLUMNS:
            text = pd.Categorical.from_codes(values, categories=pd.Index(categories[name], dtype=str))
            columns[name] = text.remove_unused_categories()
        else:
            columns[name] = values
    return pd.DataFrame(columns)
