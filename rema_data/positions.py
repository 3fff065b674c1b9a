"""Positions of steps, and the table that they count in: positions of one table are other steps in another.

A sampler hands out ``Positions``; a dataset refuses those of another table. The table of a dataset carries a mark, by
which a sampler sees that its rows were picked or sorted since.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from rema_data.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Positions", "mark_table", "refuse_changed_rows", "refuse_foreign"]

_MARK = "rema_data"
"""Key in ``DataFrame.attrs``, which pandas hands on to what is made of a table."""
_NAMES_A_ROW = ("round", "episode", "step", "action")
"""Columns by which the order of rows is recognised."""
_SELECT = "part = dataset.select(mask), and give `part` to the sampler and to the loader"


class Positions(list[int]):
    """Row numbers of one batch, and whose they are.

    Attributes
    ----------
    source : str or None
        Fingerprint of the dataset; None where the table that was sampled has none.
    rows : int
        Rows of the table.
    """

    __slots__ = ("rows", "source")

    def __init__(self, positions: Iterable[int] = (), source: str | None = None, rows: int = -1) -> None:
        super().__init__(positions)
        self.source = source
        self.rows = rows


def refuse_foreign(positions: Any, source: str, rows: int) -> None:
    """Raise InputError where positions count in another table than that of a dataset with these rows."""
    if isinstance(positions, Positions) and (positions.rows != rows or positions.source not in (None, source)):
        raise InputError(
            f"the positions count in another table ({positions.rows:,} rows) than this dataset's ({rows:,} steps)",
            hint=f"sample the dataset that the loader reads; for some of its steps: {_SELECT}",
            source=positions.source,
        )


def mark_table(table: pd.DataFrame, fingerprint: str) -> pd.DataFrame:
    """The table of a dataset, marked with its fingerprint and the order of its rows."""
    table.attrs[_MARK] = {"dataset": fingerprint, "rows": len(table), "order": _order(table)}
    return table


def refuse_changed_rows(table: Any) -> None:
    """Raise InputError where a marked table no longer has the rows of its dataset in their order.

    Other values in a column, or columns more or less, are no reason.
    """
    mark = getattr(table, "attrs", {}).get(_MARK)
    if mark is None:
        return
    order = _order(table)
    numbered = bool((np.asarray(table.index) == np.arange(len(table))).all())
    if len(table) != mark["rows"] or not (numbered if order is None else order == mark["order"]):
        raise InputError(
            f"rows of this table were picked or sorted: it has {len(table):,}, and its dataset {mark['rows']:,}, "
            "where a row number of this table is another step",
            hint=f"select the steps of the dataset instead: {_SELECT}",
            dataset=mark["dataset"],
        )


def _order(table: Any) -> str | None:
    """Hash of which step lies in which row; None where the columns that tell are gone."""
    if not set(_NAMES_A_ROW) <= set(table.columns):
        return None
    digest = hashlib.blake2b(digest_size=16)
    for name in _NAMES_A_ROW:
        digest.update(np.ascontiguousarray(table[name], "<i4").data)
    return digest.hexdigest()
