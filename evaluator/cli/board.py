"""The leaderboard as tables for people: one a task and protocol, with as many columns as the terminal has room for."""

from __future__ import annotations

from collections.abc import Sequence

from evaluator.cli.output import line, print_table, styled
from evaluator.leaderboard import Board, Row
from evaluator.leaderboard.export import COLUMNS, cells, titled_groups
from evaluator.leaderboard.suite_tables import SuiteTable
from evaluator.protocol import BLANKED

__all__ = ["print_board", "print_suite"]

_STYLES = {"published": "dim", "privileged": "magenta", "simulator": "magenta", "random": "blue"}
_IN_TITLE = ("task", "protocol")
_NUMBERS = ("rank", "k/n", "rate %", "z")
_OPTIONAL = (
    "failures",
    "sandbox",
    "errors",
    "funnel %",
    "z",
    *(f"{name} %" for name in BLANKED),
    "clean - fresh",
    "hard %",
    "end-to-end %",
    "rank",
    "tag",
    "ties",
)
"""Columns that a narrow terminal does without, the first one first."""
_LOUD = ("ANOTHER SIMULATOR", "FRESH", "LEFT OUT", "NOT VERIFIED")


def print_board(board: Board) -> None:
    """Print a board on stdout, and the remarks below."""
    if not board.rows:
        line("no runs: score a policy with `rema evaluate`")
    hidden: set[str] = set()
    for title, rows in titled_groups(board):
        hidden |= _print_group(title, rows)
    if hidden:
        missing = ", ".join(name for name in COLUMNS if name in hidden)
        line(f"no room for all of: {missing}; a wider terminal or --export md shows them", "dim")
    for remark in board.remarks:
        line(remark, "bold red" if remark.startswith(_LOUD) else "dim")


def print_suite(tables: Sequence[SuiteTable], remarks: Sequence[str]) -> None:
    """Print the tables of a suite on stdout, and what is to be said about their rows."""
    if not tables:
        line("nothing was played over this suite: rema evaluate POLICY --suite hard-v1")
    for table in tables:
        right = tuple(name for name in table.header if name not in ("policy", "tag", "ties", "worst axis"))
        optional = ("tag", "worst axis", "kept %", "ties", "rank", "clean %")
        print_table(table.header, table.lines, title=table.title, right=right, optional=optional)
    for remark in remarks:
        line(remark)


def _print_group(title: str, rows: Sequence[Row]) -> set[str]:
    """Print one task and protocol without columns that are empty; return those that found no room."""
    records = [dict(zip(COLUMNS, cells(row), strict=True)) for row in rows]
    shown = [
        name for name in COLUMNS if name not in _IN_TITLE and any(record[name] not in ("", "-") for record in records)
    ]
    return print_table(
        shown,
        (
            styled((record[name] for name in shown), _STYLES.get(row.tag, ""))
            for row, record in zip(rows, records, strict=True)
        ),
        title=title,
        right=_NUMBERS,
        optional=_OPTIONAL,
    )
