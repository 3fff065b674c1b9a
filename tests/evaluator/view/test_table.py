"""Queries against plain loops over the same rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from urllib.parse import urlencode

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.view.query import COMPARISONS, parse_query
from evaluator.view.table import EpisodeTable, Field
from rema_data.errors import InputError

FIELDS = (
    Field("id", "the episode"),
    Field("task", "what", filtered=True),
    Field("round", "when", filtered=True),
    Field("failure", "why", filtered=True),
    Field("steps", "how many"),
    Field("lift_m", "how high", "m"),
)
ROW = st.fixed_dictionaries(
    {
        "task": st.sampled_from(["grasp", "push"]),
        "round": st.integers(1, 12),
        "failure": st.sampled_from([None, "missed", "Blocked"]),
        "steps": st.integers(0, 3),
        "lift_m": st.sampled_from([None, 0.0, 0.25, 2.0]),
    }
)
QUERY = st.lists(
    st.sampled_from(
        [
            *(("task", "grasp"), ("task", "push"), ("failure", "missed"), ("round", "3"), ("round", "11")),
            *(("q", "MISS"), ("q", "2"), ("q", "e1"), ("q", "lift_m>0.1"), ("q", "lift_m<=0"), ("q", "steps!=2")),
            *(("q", "round>=3 task=push"), ("q", "failure!=missed")),
        ]
    ),
    max_size=4,
)
TYPES = {"round": pa.int16(), "steps": pa.int8(), "lift_m": pa.float64()}


def table_of(rows: list[dict[str, Any]]) -> EpisodeTable:
    columns = {"id": pa.array([f"e{n}" for n in range(len(rows))], pa.string())}
    for field in FIELDS[1:]:
        columns[field.name] = pa.array([row[field.name] for row in rows], TYPES.get(field.name, pa.string()))
    return EpisodeTable(FIELDS, columns)


def holds(word: str) -> Callable[[dict[str, Any]], bool]:
    """A word of a search, as the documentation says it."""
    for sign, compare in COMPARISONS.items():
        name, found, value = word.partition(sign)
        if found:
            if name in TYPES:
                return lambda row: row[name] is not None and compare(row[name], float(value))
            return lambda row: row[name] is not None and compare(row[name].lower(), value.lower())
    low = word.lower()

    def anywhere(row: dict[str, Any]) -> bool:
        texts = [row["id"], row["task"], row["failure"] or ""]
        return any(low in text.lower() for text in texts) or low in (str(row["round"]), str(row["steps"]))

    return anywhere


@given(st.lists(ROW, min_size=1, max_size=20), QUERY, st.sampled_from(["", *(field.name for field in FIELDS)]))
def test_a_query_selects_what_a_loop_selects(
    rows: list[dict[str, Any]], pairs: list[tuple[str, str]], sort: str
) -> None:
    rows = [{"id": f"e{n}", **row} for n, row in enumerate(rows)]
    table = table_of(rows)
    chosen: dict[str, set[str]] = {}
    for name, value in pairs:
        if name != "q":
            chosen.setdefault(name, set()).add(value)
    known = {name: {str(row[name]) for row in rows} for name in chosen}
    pairs = [(name, value) for name, value in pairs if name == "q" or value in known[name]]
    chosen = {name: {value for value in values if value in known[name]} for name, values in chosen.items()}
    chosen = {name: values for name, values in chosen.items() if values}
    words = [word for name, value in pairs if name == "q" for word in value.split()]
    kept = [
        row
        for row in rows
        if all(str(row[name]) in values for name, values in chosen.items()) and all(holds(word)(row) for word in words)
    ]
    for downwards in (False, True):
        ordered = kept
        if sort == "id":
            ordered = kept[::-1] if downwards else kept
        elif sort:
            there = [row for row in kept if row[sort] is not None]
            ordered = sorted(there, key=lambda row: row[sort], reverse=downwards)
            if downwards:  # equals stay in their order
                ordered = sorted(there, key=lambda row: sorted({r[sort] for r in there}, reverse=True).index(row[sort]))
            ordered = ordered + [row for row in kept if row[sort] is None]
        asked = [*pairs, ("sort", f"-{sort}" if downwards else sort)] if sort else pairs
        found = table.select(parse_query(urlencode(asked)))
        assert [table.row(place) for place in found.rows.tolist()] == ordered
    for name, values in found.counts.items():
        others = [pair for pair in pairs if pair[0] != name]
        for value, count in values.items():
            assert count == len(table.select(parse_query(urlencode([*others, (name, value)]))).rows)


@pytest.mark.parametrize(
    ("query", "sentence", "hint"),
    [
        ("colour=red", "no column colour", "id, task, round"),
        ("task=fly", "no episode has task fly", "grasp"),
        ("steps=1", "steps is not a column with a few values", "q=steps>0"),
        ("q=width>1", "no column width", "lift_m"),
        ("q=lift_m>high", "'high' is not a number", "lift_m>0.05"),
        ("sort=width", "no column width", "lift_m"),
    ],
)
def test_what_is_not_there_is_named(query: str, sentence: str, hint: str) -> None:
    rows = [{"task": "grasp", "round": 1, "failure": None, "steps": 1, "lift_m": 0.1}]
    with pytest.raises(InputError, match=sentence) as caught:
        table_of(rows).select(parse_query(query))
    assert hint in caught.value.hint


def test_a_table_without_rows_answers() -> None:
    found = table_of([]).select(parse_query("q=missed"))
    assert len(found.rows) == 0
