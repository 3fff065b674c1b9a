"""Steps that meet a condition over the columns of both tables, as ``target_shape = 'T' and lift_m < 0.1``.

A condition is an SQL expression, which DuckDB (the extra ``query``) parses and evaluates. A step for which it is null,
as where a column that it compares is null, does not meet it.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, Column

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["COLUMNS", "steps_that_meet"]

_EXTRA = 'pip install "rema[query]"'
_OF_STEPS = {column.name: column for column in STEP_COLUMNS}
_KEYS = ("task", "round", "split", "episode")
"""Columns that both tables have, with the same value in every step of an episode."""
_OF_EPISODES = {
    f"episode_{column.name}" if column.name in _OF_STEPS else column.name: column
    for column in EPISODE_COLUMNS
    if column.name not in _KEYS
}
COLUMNS: dict[str, Column] = {**_OF_STEPS, **_OF_EPISODES}
"""What a condition may name: the columns of steps, and those of the episode: ``episode_success``, ``seed``, ..."""
_POSITION = "position among the steps"
"""Name of the column that tells which row is which: a window function gives rows in an order of its own."""


def steps_that_meet(where: str, tables: Sequence[tuple[pa.Table, pa.Table]]) -> npt.NDArray[np.bool_]:
    """Whether steps meet a condition, one truth value a step.

    Parameters
    ----------
    where : str
        The condition.
    tables : sequence of (episodes, steps)
        The tables of some blocks. A condition that compares a step with others sees the steps of all of them.

    Raises
    ------
    InputError
        DuckDB is not installed; the condition cannot be parsed, names an unknown column, compares values whose types
        do not fit, or is no condition.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    try:
        import duckdb
    except ModuleNotFoundError:
        raise InputError("a condition (where) needs DuckDB, which is not installed", hint=_EXTRA) from None
    table = pa.concat_tables([_joined(episodes, steps) for episodes, steps in tables])
    table = table.append_column(_POSITION, pa.array(np.arange(len(table))))
    # A condition reads the table and nothing else: no files, no extensions, no variables of this process.
    closed: dict[str, Any] = {
        "enable_external_access": False,
        "python_enable_replacements": False,
        "lock_configuration": True,
        "threads": 1,  # and no thread that a forked worker would miss
    }
    with duckdb.connect(":memory:", config=closed) as connection:
        try:
            found: Any = connection.from_arrow(table).project(f'"{_POSITION}", {where}').to_arrow_table()
        except duckdb.Error as error:
            raise _explained(where, str(error)) from error
    types = [str(field.type) for field in found.schema][1:]
    positions = found.column(0).to_numpy()
    if types != ["bool"] or not np.array_equal(np.sort(positions), np.arange(len(table))):
        raise _no_condition(where, f"it gives {', '.join(types) or 'nothing'}")
    met = np.empty(len(table), bool)
    met[positions] = pc.fill_null(found.column(1), False).to_numpy()
    return met


def _joined(episodes: pa.Table, steps: pa.Table) -> pa.Table:
    """The steps of a block with the columns of their episodes."""
    rows = np.repeat(np.arange(len(episodes)), episodes["steps"].to_numpy())
    for name, column in _OF_EPISODES.items():
        steps = steps.append_column(name, episodes[column.name].take(rows))
    return steps


def _no_condition(where: str, what: str) -> InputError:
    return InputError(
        f"where={where!r} is not one condition a step: {what}",
        hint="compare values, for example \"target_shape = 'T' and lift_m < 0.1\"",
        where=where,
    )


def _explained(where: str, problem: str) -> InputError:
    """What DuckDB says of a condition, in terms of the tables."""
    kind, _, what = problem.partition(": ")
    first = what.partition("\n")[0].strip() or kind
    if "GROUP BY" in first:
        return _no_condition(where, "it sums up steps; to compare with them, add OVER, as in avg(lift_m) over ()")
    unknown = re.search(r'Referenced column "(.*?)" not found', what)
    if unknown:
        name = unknown[1]
        near = difflib.get_close_matches(name.lower(), COLUMNS, n=4, cutoff=0.5)
        hint = f"the nearest names: {', '.join(near)}" if near else "text stands in single quotes, as in policy = 'tae'"
        return InputError(f"where={where!r}: there is no column {name!r}", hint=hint, column=name, nearest=tuple(near))
    named = [column for column in COLUMNS if re.search(rf"\b{column}\b", where, re.IGNORECASE)]
    types = ", ".join(f"{name} is {COLUMNS[name].type}" for name in named)
    return InputError(
        f"where={where!r}: {first}",
        hint=types or "write an SQL condition, for example \"target_shape = 'T' and lift_m < 0.1\"",
        where=where,
    )
