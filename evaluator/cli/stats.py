"""``rema stats``: positives and negatives of a release."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.table import Table

    from rema_data.statistics.count import Statistics, StepCount
    from rema_data.statistics.paper import Comparison, Counts, PaperRow

__all__ = ["stats"]


@click.command()
@click.argument("release", required=False)
@click.option("--check-paper", is_flag=True, help="Beside the upper half of the paper's Table 2.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw the data by round.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
def stats(release: str | None, check_paper: bool, plot: Path | None, as_json: bool) -> None:
    """Count positives and negatives of RELEASE by round, task, split and step.

    RELEASE is a name or a folder; by default the newest release on this machine.
    """
    from rema_data.release.folder import find_release
    from rema_data.statistics.count import count
    from rema_data.statistics.paper import compare

    found = count(find_release(release))
    comparison = compare(found) if check_paper else None
    if plot is not None:
        from rema_data.statistics.plot import plot_rounds

        plot_rounds(found, plot)
    if as_json:
        paper = {} if comparison is None else {"paper": comparison.to_dict()}
        click.echo(json.dumps(found.to_dict() | paper, indent=2))
        return
    _print(found, comparison)
    if plot is not None:
        click.echo(plot)


def _print(found: Statistics, comparison: Comparison | None) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console()
    title = f"{found.release} ({found.sha256[:12]})"
    if found.steps:
        for number, rows in groupby(found.steps, key=lambda row: row.round):
            console.print(_steps_table(rows, f"{title}, round {number}"))
        console.print(_totals_table(found))
    else:
        console.print(Text(f"{title}: no block is on this machine"))
    if found.missing:
        console.print(Text(_missing(found), style="yellow"))
    if comparison is not None:
        console.print(_paper_table(comparison, found.release))
        for remark in comparison.remarks:
            console.print(Text(f"- {remark}"))


def _table(title: str, columns: Sequence[str], numbers: int) -> Table:
    """A table whose last ``numbers`` columns are numbers."""
    from evaluator.cli.tables import make_table

    no_wrap = [name for name in columns if name != "policy"]
    return make_table(columns, title=title, right=columns[-numbers:], no_wrap=no_wrap)


def _steps_table(rows: Iterable[StepCount], title: str) -> Table:
    """Every step of every block of a round; what stays the same from row to row is printed once."""
    table = _table(title, ("task", "split", "step", "policy", "reached", "+", "-", "% +"), 4)
    for task, of_task in groupby(rows, key=lambda row: row.task):
        name = task
        for split, of_block in groupby(of_task, key=lambda row: row.split):
            shown = split
            for row in of_block:
                step = f"{row.step + 1} {'last' if row.last else row.skill}"
                counts = (f"{row.reached:,}", f"{row.positives:,}", f"{row.negatives:,}")
                table.add_row(name, shown, step, row.policy or "-", *counts, _percent(row.positives, row.reached))
                name = shown = ""
        table.add_section()
    return table


def _totals_table(found: Statistics) -> Table:
    columns = ("task", "episodes", "steps", "last steps", "+", "-", "% +")
    table = _table("all rounds and splits; + and - of the last steps", columns, 6)
    rows = [(row.task, row.episodes, row.executed, row.reached, row.positives, row.negatives) for row in found.totals()]
    sums = [sum(column) for column in list(zip(*rows, strict=True))[1:]]
    for name, *counts in (*rows, ("sum", *sums)):
        if name == "sum":
            table.add_section()
        share = _percent(counts[3], counts[2])
        table.add_row(name, *(f"{value:,}" for value in counts), share, style="bold" if name == "sum" else "")
    return table


def _missing(found: Statistics) -> str:
    episodes = sum(block.episodes for block in found.missing)
    listed = [block.key.path for block in found.missing[:6]]
    names = ", ".join(listed) + (", ..." if len(found.missing) > len(listed) else "")
    return (
        f"not counted: {len(found.missing)} blocks with {episodes:,} episodes that are not on this machine ({names}). "
        f"{found.fix[:1].upper()}{found.fix[1:]}"
    )


def _paper_table(comparison: Comparison, release: str) -> Table:
    numbers = ("+", "-", "rows", "% +")
    columns = ("", *(f"{whose}\n{name}" for whose in ("paper", "ours") for name in numbers))
    table = _table(f"the paper's Table 2 beside {release}", columns, 2 * len(numbers))
    for row in comparison.tasks:
        table.add_row(row.name, *_cells(row))
    table.add_section()
    table.add_row(comparison.total.name, *_cells(comparison.total), style="bold")
    for row in comparison.earlier:
        table.add_row(row.name, *_cells(row))
    table.add_section()
    table.add_row(comparison.executed.name, *_cells(comparison.executed), style="bold")
    return table


def _cells(row: PaperRow) -> tuple[str, ...]:
    return (*_counts(row.paper), *_counts(row.ours))


def _counts(counts: Counts | None) -> tuple[str, ...]:
    if counts is None:
        return ("",) * 4
    share = _percent(counts.positives, counts.rows)
    return (f"{counts.positives:,}", f"{counts.negatives:,}", f"{counts.rows:,}", share)


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f}" if whole else "-"
