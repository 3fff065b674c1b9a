"""The leaderboard as tables for people: one a task and protocol, with as many columns as the terminal has room for."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.leaderboard import Board, Row
from evaluator.leaderboard.export import COLUMNS, cells, titled_groups

__all__ = ["print_board"]

_STYLES = {"published": "dim", "privileged": "magenta", "random": "blue"}
_IN_TITLE = ("task", "protocol")
_NUMBERS = ("rank", "k/n", "rate %", "z")
_GIVEN_UP = ("failures", "sandbox", "errors", "funnel %", "z", "end-to-end %", "rank", "tag", "ties")
"""Columns that a narrow terminal does without, the first one first."""
_FOLDED = {"policy": 24, "failures": 18, "errors": 14}
"""Columns that may be folded, to this width."""
_GAP = 3
_LOUD = ("ANOTHER SIMULATOR", "LEFT OUT")


def print_board(board: Board) -> None:
    """Print a board on stdout, and the remarks below."""
    console = Console()
    if not board.rows:
        console.print("no runs: score a policy with `rema evaluate`", markup=False)
        return
    hidden: dict[str, None] = {}
    for title, rows in titled_groups(board):
        table, given_up = _table(title, rows, console.width)
        console.print(table)
        hidden |= dict.fromkeys(given_up)
    if hidden:
        missing = ", ".join(name for name in COLUMNS if name in hidden)
        console.print(Text(f"no room for all of: {missing}; a wider terminal or --export md shows them", style="dim"))
    for remark in board.remarks:
        console.print(Text(remark, style="bold red" if remark.startswith(_LOUD) else "dim"))


def _table(title: str, rows: Sequence[Row], width: int) -> tuple[Table, list[str]]:
    """One task and protocol, and the columns that found no room; those in which every cell is empty are left out."""
    lines = [dict(zip(COLUMNS, cells(row), strict=True)) for row in rows]
    shown = [name for name in COLUMNS if name not in _IN_TITLE and any(line[name] not in ("", "-") for line in lines)]
    widths = {name: max(cell_len(line[name]) for line in [*lines, {name: name}]) for name in shown}
    narrowest = {name: min(widths[name], _FOLDED.get(name, widths[name])) for name in shown}
    given_up = []
    for name in _GIVEN_UP:
        if sum(narrowest[column] + _GAP for column in shown) > width and name in shown:
            shown.remove(name)
            given_up.append(name)
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1)
    )
    for name in shown:
        table.add_column(
            name,
            justify="right" if name in _NUMBERS else "left",
            no_wrap=name not in _FOLDED,
            min_width=narrowest[name],
            overflow="fold",
        )
    for row, line in zip(rows, lines, strict=True):
        table.add_row(*(Text(line[name]) for name in shown), style=_STYLES.get(row.tag, ""))
    return table, given_up
