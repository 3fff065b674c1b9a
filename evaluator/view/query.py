"""What is asked of the table, as it stands in the address of the page: ``task=grasp&failure=missed&q=lift_m>0.05``."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

__all__ = ["COMPARISONS", "Query", "Term", "parse_query"]

COMPARISONS: Mapping[str, Callable[[Any, Any], Any]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
}
_COMPARISON = re.compile(r"([a-z][a-z0-9_]*)(>=|<=|!=|>|<|=)(.+)")
_TEXT, _SORT = "q", "sort"
Term = str | tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class Query:
    """Filters, free text and order; every part must hold."""

    chosen: tuple[tuple[str, tuple[str, ...]], ...] = ()  # a column, and the values of which a row has one
    # a word in lower case that stands in any column, or a column, a sign of COMPARISONS and a value
    terms: tuple[Term, ...] = ()
    sort: str = ""  # a column, with a minus for downwards; empty for the order of the table


def parse_query(text: str, ignored: Iterable[str] = ()) -> Query:
    """A query from the text of an address, without the parameters in ``ignored``."""
    chosen: dict[str, list[str]] = {}
    terms: list[Term] = []
    sort = ""
    for name, value in parse_qsl(text, keep_blank_values=True):
        if name in ignored:
            continue
        if name == _TEXT:
            terms += map(_term, value.split())
        elif name == _SORT:
            sort = value
        else:
            chosen.setdefault(name, []).append(value)
    return Query(tuple((name, tuple(values)) for name, values in chosen.items()), tuple(terms), sort)


def _term(word: str) -> Term:
    compared = _COMPARISON.fullmatch(word)
    return word.lower() if compared is None else (compared[1], compared[2], compared[3])
