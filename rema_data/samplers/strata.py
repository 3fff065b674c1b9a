"""Rows of a table by their labels: one array of row numbers a stratum."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Label", "Strata", "column_of", "label_text", "stratify"]

Label = tuple[Any, ...]
"""Values of the columns that make a stratum, in their order."""
Rows = npt.NDArray[np.signedinteger[Any]]
MOST_COMBINATIONS = 2**24
MOST_STRATA = 2**15 - 1


@dataclass(frozen=True, eq=False)
class Strata:
    """The rows of a table, grouped."""

    by: tuple[str, ...]  # the columns
    labels: tuple[Label, ...]  # sorted; every stratum has at least one row
    rows: tuple[Rows, ...]  # row numbers of every stratum, ascending
    codes: Rows  # stratum of every row of the table

    @property
    def sizes(self) -> npt.NDArray[np.int64]:
        """Rows of every stratum, int64 (strata,)."""
        return np.array([len(rows) for rows in self.rows], np.int64)

    def fingerprint(self) -> str:
        """Hash of which row has which label: the identity of a table that has no other."""
        digest = hashlib.blake2b(repr((self.by, self.labels)).encode(), digest_size=16)
        digest.update(np.ascontiguousarray(self.codes, "<i2").data)
        return digest.hexdigest()


def column_of(table: Any, name: str) -> pd.Series[Any]:
    """A column of a table; raises InputError where it is missing, or is not one value a row."""
    import pandas as pd

    names = list(table) if isinstance(table, Mapping) else [str(column) for column in table.columns]
    if name not in names:
        raise InputError(f"the table has no column {name!r}", hint=f"it has {', '.join(names)}", column=name)
    column = table[name]
    if isinstance(column, pd.Series):
        return column
    values = column if isinstance(column, pd.Categorical) else np.asarray(column)
    if np.ndim(values) != 1:
        raise InputError(f"column {name!r} has {np.ndim(values)} dimensions", hint="give one value a row", column=name)
    return pd.Series(values, copy=False)


def label_text(by: Sequence[str], label: Label) -> str:
    """A label as ``task=grasp, success=True``."""
    return ", ".join(f"{name}={value}" for name, value in zip(by, label, strict=True))


def stratify(table: Any, by: Sequence[str], on_empty: str = "raise") -> Strata:
    """Group the rows of a table by its columns ``by``.

    The strata are the combinations that occur of the columns that are not truth values, each with every combination of
    those that are: a table of successes lacks failures, whether or not a row says so. A combination without a row
    raises InputError, or with "renormalise" shares its draws among the others.
    """
    by = tuple(by)
    if not by or len(set(by)) < len(by):
        raise InputError(f"by={by!r} does not name different columns", hint='for example by=("task", "success")')
    columns = [_factorise(column_of(table, name), name) for name in by]
    lengths = {len(codes) for codes, _ in columns}
    if len(lengths) > 1:
        raise InputError(f"the columns {', '.join(by)} differ in length", hint="give one value a row to each")
    if lengths == {0}:
        raise InputError("the table has no rows", hint="select more: other tasks, rounds or another split")

    shape = tuple(len(values) for _, values in columns)
    combinations = math.prod(shape)
    if combinations > MOST_COMBINATIONS:
        raise InputError(
            f"the columns {', '.join(by)} have {combinations:,} combinations", hint="balance by columns of few values"
        )
    combined = np.zeros(lengths.pop(), np.int32)
    for codes, values in columns:
        combined *= len(values)
        combined += codes
    counts = np.bincount(combined, minlength=combinations)
    implied = _implied(counts.reshape(shape), [values for _, values in columns])
    empty = implied[counts[implied] == 0]
    if len(empty) and on_empty == "raise":
        labels = tuple(label_text(by, _label(int(code), columns, shape)) for code in empty)
        raise InputError(
            f"the stratum {labels[0]} has no rows" + (f" (and {len(labels) - 1} more)" if len(labels) > 1 else ""),
            hint='select other data, or pass on_empty="renormalise" to share its draws among its neighbours',
            strata=labels,
        )
    kept = np.flatnonzero(counts)
    if len(kept) > MOST_STRATA:
        raise InputError(f"{', '.join(by)} make {len(kept):,} strata", hint="balance by columns of few values")
    position = np.full(combinations, -1, np.int16)
    position[kept] = np.arange(len(kept))
    codes = position[combined]
    order = np.argsort(codes, kind="stable")  # a radix sort
    order = order.astype(np.int32 if len(order) < 2**31 else np.int64)
    rows = np.split(order, np.cumsum(counts[kept])[:-1])
    return Strata(by, tuple(_label(int(code), columns, shape) for code in kept), tuple(rows), codes)


Column = tuple[npt.NDArray[Any], list[Any]]
"""Codes of the rows, and the sorted values that they stand for."""


def _factorise(column: pd.Series[Any], name: str) -> Column:
    import pandas as pd

    if isinstance(column.dtype, pd.CategoricalDtype):
        codes, values = np.asarray(column.cat.codes), list(column.cat.categories)
        occurs = np.bincount(codes[codes >= 0], minlength=len(values)) > 0
    else:
        codes, uniques = pd.factorize(column)
        values = uniques.tolist()
        occurs = np.ones(len(values), bool)
    if len(codes) and codes.min() < 0:
        raise InputError(
            f"column {name!r} has missing values", hint="drop those rows, or fill them in, before sampling", column=name
        )
    if pd.api.types.is_bool_dtype(column.dtype) or _are_truths(values):
        values = [bool(value) for value in values]
        values += [value for value in (False, True) if value not in values]
        occurs = np.ones(len(values), bool)  # both count, whether or not they occur
    wanted = np.flatnonzero(occurs)
    try:
        ranking = sorted(wanted.tolist(), key=lambda code: values[code])
    except TypeError:
        ranking = sorted(wanted.tolist(), key=lambda code: str(values[code]))
    place = np.zeros(len(values), np.int32)  # enough for MOST_COMBINATIONS
    place[ranking] = np.arange(len(ranking))
    return place[codes], [values[code] for code in ranking]


def _are_truths(values: Sequence[Any]) -> bool:
    return all(isinstance(value, bool) for value in values)  # 0 and 1 are numbers


def _implied(counts: npt.NDArray[np.int64], values: Sequence[Sequence[Any]]) -> npt.NDArray[np.int64]:
    """Combinations that should have rows: those that occur, with every truth value; flat numbers, ascending."""
    truths = tuple(axis for axis, column in enumerate(values) if _are_truths(column))
    occurs = counts.sum(axis=truths, keepdims=True) > 0
    return np.flatnonzero(np.broadcast_to(occurs, counts.shape))


def _label(code: int, columns: Sequence[Column], shape: tuple[int, ...]) -> Label:
    return tuple(values[place] for (_, values), place in zip(columns, np.unravel_index(code, shape), strict=True))
