"""The leaderboard as tables for people: one a task and protocol, with as many columns as the terminal has room for."""

from __future__ import annotations

from collections.abc import Sequence

from rich.cells import cell_len

from evaluator.cli.output import line, print_table, styled, terminal_width
from evaluator.leaderboard import Board, Row
from evaluator.leaderboard.export import COLUMNS, cells, titled_groups

__all__ = ["print_board"]

_STYLES = {"published": "dim", "privileged": "magenta", "simulator": "magenta", "random": "blue"}
_IN_TITLE = ("task", "protocol")
_NUMBERS = ("rank", "k/n", "rate %", "z")
_OPTIONAL = ("failures", "sandbox", "errors", "funnel %", "z", "end-to-end %", "rank", "tag", "ties")
"""Columns that a narrow terminal does without, the first one first."""
_GAP = 2
_LOUD = ("ANOTHER SIMULATOR", "LEFT OUT", "NOT VERIFIED")


def print_board(board: Board) -> None:
    """Print a board on stdout, and the remarks below."""
    if not board.rows:
        line("no runs: score a policy with `rema evaluate`")
        return
    hidden: set[str] = set()
    for title, rows in titled_groups(board):
        hidden |= _print_group(title, rows)
    if hidden:
        missing = ", ".join(name for name in COLUMNS if name in hidden)
        line(f"no room for all of: {missing}; a wider terminal or --export md shows them", "dim")
    for remark in board.remarks:
        line(remark, "bold red" if remark.startswith(_LOUD) else "dim")


def _print_group(title: str, rows: Sequence[Row]) -> set[str]:
    """Print one task and protocol without columns that are empty; return those that found no room."""
    records = [dict(zip(COLUMNS, cells(row), strict=True)) for row in rows]
    shown = [
        name for name in COLUMNS if name not in _IN_TITLE and any(record[name] not in ("", "-") for record in records)
    ]
    widths = {name: max(cell_len(record[name]) for record in [*records, {name: name}]) for name in shown}
    hidden = set()
    for name in _OPTIONAL:
        if name in shown and sum(widths[column] + _GAP for column in shown) - _GAP > terminal_width():
            shown.remove(name)
            hidden.add(name)
    print_table(
        shown,
        (
            styled((record[name] for name in shown), _STYLES.get(row.tag, ""))
            for row, record in zip(rows, records, strict=True)
        ),
        title=title,
        right=_NUMBERS,
    )
    return hidden
