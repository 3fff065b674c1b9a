"""The table of episodes that is browsed: its columns, and which rows a query selects, in which order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from evaluator.view.query import COMPARISONS, Query, Term
from rema_data.errors import InputError

__all__ = ["ID", "EpisodeTable", "Field", "Selection"]

ID = "id"
"""The column that names an episode: text, every row another one."""
_WIDEST = 34
"""Characters of a column in the list, at most."""

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Field:
    """A column of the table."""

    name: str
    meaning: str
    unit: str = ""
    filtered: bool = False  # it has few values, and a filter offers them
    listed: bool = True  # the list shows it; every column can be searched and sorted by


@dataclass(frozen=True, slots=True, eq=False)
class _Texts:
    """A column of text, or of whole numbers that are filtered: ``codes`` are places in ``values``, -1 is null."""

    codes: npt.NDArray[np.int32]
    values: Sequence[str]
    whole: bool = False

    def at(self, row: int) -> str | int | None:
        code = self.codes[row]
        if code < 0:
            return None
        return int(self.values[code]) if self.whole else self.values[code]

    def ranks(self) -> npt.NDArray[Any]:
        return np.where(self.codes < 0, np.nan, self.codes.astype(np.float64))

    def width(self) -> int:
        return max(map(len, self.values), default=1)

    def containing(self, word: str) -> Mask:
        hits = np.array([word == one if self.whole else word in one.lower() for one in self.values] + [False])
        return hits[self.codes]

    def compared(self, sign: str, value: str) -> Mask:
        if self.whole:
            return _compare(self.ranks_as_numbers(), sign, value)
        hits = np.array([bool(COMPARISONS[sign](one.lower(), value.lower())) for one in self.values] + [False])
        return hits[self.codes]

    def ranks_as_numbers(self) -> npt.NDArray[np.float64]:
        return np.array([*map(float, self.values), np.nan])[self.codes]


@dataclass(frozen=True, slots=True, eq=False)
class _Numbers:
    """A column of numbers; NaN is null."""

    values: npt.NDArray[np.float64]
    whole: bool

    def at(self, row: int) -> float | int | None:
        value = float(self.values[row])
        if not math.isfinite(value):
            return None
        return int(value) if self.whole else value

    def ranks(self) -> npt.NDArray[Any]:
        return self.values

    def width(self) -> int:
        return 8

    def containing(self, word: str) -> Mask:
        """Whole numbers are found by their digits; a part of a measurement says nothing."""
        if self.whole and word.isascii() and word.isdecimal():
            found: Mask = self.values == float(word)
            return found
        return np.zeros(len(self.values), np.bool_)

    def compared(self, sign: str, value: str) -> Mask:
        return _compare(self.values, sign, value)


def _compare(values: npt.NDArray[np.float64], sign: str, value: str) -> Mask:
    try:
        bound = float(value)
    except ValueError:
        raise InputError(f"{value!r} is not a number", hint="compare a measurement like this: lift_m>0.05") from None
    found: Mask = COMPARISONS[sign](values, bound) & ~np.isnan(values)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What a query selects: ``rows`` of the table in order, and what every filter would leave."""

    rows: npt.NDArray[np.intp]
    counts: Mapping[str, Mapping[str, int]]  # by column and value, with all other filters of the query in force


class EpisodeTable:
    """All episodes of a release or of a run, one row each.

    Parameters
    ----------
    fields : sequence of Field
        The first one is ``id``.
    columns : mapping of str to pyarrow array
        Text or numbers, by the name of a field.
    """

    def __init__(self, fields: Sequence[Field], columns: Mapping[str, pa.Array | pa.ChunkedArray]) -> None:
        self.fields = tuple(fields)
        self.ids: list[str] = columns[ID].to_pylist()
        # names stay in the order of the table
        names = _Texts(np.arange(len(self.ids), dtype=np.int32), self.ids)
        self._columns: dict[str, _Texts | _Numbers] = {ID: names}
        for field in self.fields[1:]:
            self._columns[field.name] = _column(columns[field.name], field.filtered)

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.ids)}

    def place(self, name: str) -> int | None:
        """The row of an episode; None where there is no such one."""
        return self._places.get(name)

    def row(self, place: int) -> dict[str, Any]:
        """Values of one row, ready for JSON."""
        return {name: column.at(place) for name, column in self._columns.items()}

    def describe(self) -> list[dict[str, Any]]:
        """The columns, and the values that a filter offers, ready for JSON."""
        return [
            {
                "name": field.name,
                "meaning": field.meaning,
                "unit": field.unit,
                "listed": field.listed,
                "type": "whole" if column.whole else "real" if isinstance(column, _Numbers) else "text",
                "width": min(_WIDEST, max(column.width(), len(field.name))),
                "values": list(column.values) if field.filtered and isinstance(column, _Texts) else None,
            }
            for field, column in zip(self.fields, self._columns.values(), strict=True)
        ]

    def select(self, query: Query) -> Selection:
        """The rows of a query; raises InputError where it names a column or a value that is not there."""
        everything = np.ones(len(self), np.bool_)
        kept = everything
        for term in query.terms:
            kept = kept & self._term(term)
        filters = {name: self._filtered(name, values) for name, values in query.chosen}
        whole = kept
        for mask in filters.values():
            whole = whole & mask
        counts = {}
        for field in self.fields:
            column = self._columns[field.name]
            if field.filtered and isinstance(column, _Texts):
                rest = kept
                for name, mask in filters.items():
                    rest = rest & mask if name != field.name else rest
                found = np.bincount(column.codes[rest] + 1, minlength=len(column.values) + 1)[1:]
                counts[field.name] = dict(zip(column.values, found.tolist(), strict=True))
        return Selection(self._ordered(np.flatnonzero(whole), query.sort), counts)

    def _named(self, name: str) -> _Texts | _Numbers:
        if name not in self._columns:
            raise InputError(f"there is no column {name}", hint=f"the columns are {', '.join(self._columns)}")
        return self._columns[name]

    def _filtered(self, name: str, values: Sequence[str]) -> Mask:
        column = self._named(name)
        offered = [field.name for field in self.fields if field.filtered]
        if not isinstance(column, _Texts) or name not in offered:
            raise InputError(
                f"{name} is not a column with a few values",
                hint=f"search for it, such as q={name}>0, or filter by {', '.join(offered)}",
            )
        unknown = [value for value in values if value not in column.values]
        if unknown:
            raise InputError(
                f"no episode has {name} {', '.join(unknown)}", hint=f"there are: {', '.join(column.values)}"
            )
        codes = [column.values.index(value) for value in values]
        return np.isin(column.codes, codes)

    def _term(self, term: Term) -> Mask:
        if isinstance(term, tuple):
            name, sign, value = term
            return self._named(name).compared(sign, value)
        found = np.zeros(len(self), np.bool_)
        for column in self._columns.values():
            found |= column.containing(term)
        return found

    def _ordered(self, rows: npt.NDArray[np.intp], sort: str) -> npt.NDArray[np.intp]:
        """Rows by a column, downwards with a minus; nulls come last, and equals stay in the order of the table."""
        if not sort:
            return rows
        ranks = self._named(sort.removeprefix("-")).ranks()[rows]
        return rows[np.argsort(-ranks if sort.startswith("-") else ranks, kind="stable")]


def _column(array: pa.Array | pa.ChunkedArray, filtered: bool) -> _Texts | _Numbers:
    whole = pa.types.is_integer(array.type)
    if not filtered and (whole or pa.types.is_floating(array.type)):
        return _Numbers(pc.fill_null(array.cast(pa.float64()), math.nan).to_numpy(), whole)
    values = sorted(value for value in pc.unique(array).to_pylist() if value is not None)
    codes = pc.fill_null(pc.index_in(array, pa.array(values, array.type)), -1)
    return _Texts(codes.to_numpy(), [str(value) for value in values], whole)
