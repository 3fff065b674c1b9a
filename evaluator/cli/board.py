"""The leaderboard as a table for people."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.export import COLUMNS, cells
from evaluator.leaderboard import Row, remarks

__all__ = ["print_board"]

_STYLES = {"published": "dim", "privileged": "magenta", "random": "blue"}


def print_board(rows: Sequence[Row]) -> None:
    """Print ``rows`` on stdout, with a line between two tasks and the remarks below."""
    console = Console()
    if not rows:
        console.print("no runs: score a policy with `rema evaluate`", markup=False)
        return
    table = Table()
    for title in COLUMNS:
        right = title in ("k/n", "rate %", "z")
        table.add_column(title, justify="right" if right else "left", overflow="fold", no_wrap=title in ("k/n", "95 %"))
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        last = following is None or following.task != row.task
        table.add_row(*(Text(cell) for cell in cells(row)), style=_STYLES.get(row.tag, ""), end_section=last)
    console.print(table)
    for remark in remarks(rows):
        console.print(Text(remark, style="dim"))
