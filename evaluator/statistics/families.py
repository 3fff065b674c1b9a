"""Many comparisons at once: adjusted p values, and letters that group policies without a significant difference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from string import ascii_lowercase

from rema_data.errors import InputError

__all__ = ["benjamini_hochberg", "holm", "tie_letters"]


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's adjusted p values, in the order given: the chance of any false claim stays below the level.

    Raises
    ------
    InputError
        A value is outside 0..1.
    """
    values = _checked(p_values)
    adjusted, largest = [1.0] * len(values), 0.0
    for place, position in enumerate(sorted(range(len(values)), key=values.__getitem__)):
        largest = max(largest, min(1.0, (len(values) - place) * values[position]))
        adjusted[position] = largest
    return adjusted


def benjamini_hochberg(p_values: Sequence[float]) -> list[float]:
    """Benjamini-Hochberg adjusted p values: the expected share of false claims stays below the level.

    For exploring strata, not for the headline. Errors are those of ``holm``.
    """
    values = _checked(p_values)
    if not values:
        return []
    from scipy.stats import false_discovery_control

    return [float(value) for value in false_discovery_control(values)]


def _checked(p_values: Sequence[float]) -> list[float]:
    values = [float(value) for value in p_values]
    for value in values:
        if not 0 <= value <= 1 or math.isnan(value):
            raise InputError(f"p value {value}", hint="give p values in 0..1", value=value)
    return values


def tie_letters(count: int, different: set[tuple[int, int]]) -> list[str]:
    """A compact letter display: two of ``count`` share a letter exactly where they do not differ.

    Insert and absorb (Piepho 2004).

    Parameters
    ----------
    count : int
        Numbered from 0 in the order in which letters are given, best first.
    different : set of (int, int)
        Pairs that differ; the order within a pair does not matter.

    Returns
    -------
    list of str
        Letters of each, such as ``a``, ``ab``, ``b``; separated by commas where 26 are not enough.
    """
    columns = [frozenset(range(count))]
    for left, right in sorted(different):
        split = [column - {one} for column in columns if {left, right} <= column for one in (right, left)]
        kept = [column for column in columns if not {left, right} <= column]
        for column in split:
            if not any(column <= other for other in kept):
                kept = [other for other in kept if not other < column] + [column]
        columns = kept
    columns.sort(key=sorted)
    names = [_letter(number) for number in range(len(columns))]
    joint = "" if len(columns) <= len(ascii_lowercase) else ","
    return [
        joint.join(name for name, column in zip(names, columns, strict=True) if member in column)
        for member in range(count)
    ]


def _letter(number: int) -> str:
    more, rest = divmod(number, len(ascii_lowercase))
    return (_letter(more - 1) if more else "") + ascii_lowercase[rest]
