"""The leaderboard as tables for people: one a task and protocol, narrow enough for 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.export import COLUMNS, cells
from evaluator.leaderboard import Row, remarks

__all__ = ["print_board"]

_STYLES = {"published": "dim", "privileged": "magenta", "random": "blue"}
_ELSEWHERE = ("task", "protocol", "errors")  # in the title, and among the failures
_NUMBERS = ("k/n", "rate %", "z")
_NAME_WIDTH = 24
_NARROW = 80


def print_board(rows: Sequence[Row]) -> None:
    """Print ``rows`` on stdout, and the remarks below."""
    console = Console()
    if not rows:
        console.print("no runs: score a policy with `rema evaluate`", markup=False)
        return
    for (task, protocol), group in groupby(rows, key=lambda row: (row.task, row.protocol)):
        console.print(_table(f"{task}, {protocol}", list(group), console.width))
    for remark in remarks(rows):
        console.print(Text(remark, style="dim"))


def _table(title: str, rows: Sequence[Row], width: int) -> Table:
    """One task; left out are columns in which every cell is empty, and two on a narrow terminal."""
    lines = [dict(zip(COLUMNS, cells(row), strict=True)) for row in rows]
    for row, line in zip(rows, lines, strict=True):
        lost = f"{row.infra_errors} not measured" if row.infra_errors else ""
        line["failures"] = "; ".join(part for part in (lost, line["failures"]) if part)
    left_out = (*_ELSEWHERE, "z", "failures") if width < _NARROW else _ELSEWHERE
    shown = [name for name in COLUMNS if name not in left_out and any(line[name] for line in lines)]
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1)
    )
    for name in shown:
        widest = max(len(line[name]) for line in lines)
        table.add_column(
            name,
            justify="right" if name in _NUMBERS else "left",
            no_wrap=name not in ("policy", "failures"),
            min_width=min(widest, _NAME_WIDTH) if name == "policy" else None,
            overflow="fold",
        )
    for row, line in zip(rows, lines, strict=True):
        table.add_row(*(Text(line[name]) for name in shown), style=_STYLES.get(row.tag, ""))
    return table
