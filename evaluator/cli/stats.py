"""``rema stats``: positives and negatives of a release."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import click

from evaluator.cli.options import json_option, release_argument
from evaluator.cli.output import line, print_json, print_table, styled

if TYPE_CHECKING:
    from rich.text import Text

    from rema_data.statistics.count import Statistics, StepCount
    from rema_data.statistics.paper import Comparison, Counts, PaperRow

__all__ = ["stats"]


@click.command()
@release_argument
@click.option("--check-paper", is_flag=True, help="Beside the upper half of the paper's Table 2.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw the data by round.")
@json_option
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
        print_json(found.to_dict() | ({} if comparison is None else {"paper": comparison.to_dict()}))
        return
    _print(found)
    if comparison is not None:
        _print_paper(comparison, found.release)
    if plot is not None:
        line(str(plot))


def _print(found: Statistics) -> None:
    title = f"{found.release} ({found.sha256[:12]})"
    if found.steps:
        counts = ["reached", "+", "-", "% +"]
        for number, rows in groupby(found.steps, key=lambda row: row.round):
            columns = ("task", "split", "step", "policy", *counts)
            print_table(columns, _step_rows(rows), title=f"{title}, round {number}", right=counts)
        counts = ["episodes", "steps", "last steps", "+", "-", "% +"]
        title_of_sums = "all rounds and splits; + and - of the last steps"
        print_table(("task", *counts), _total_rows(found), title=title_of_sums, right=counts)
    else:
        line(f"{title}: no block is on this machine")
    if found.missing:
        line(_missing(found), "yellow")


def _step_rows(rows: Iterable[StepCount]) -> Iterator[tuple[str, ...] | None]:
    """Every step of every block of a round."""
    for number, (task, of_task) in enumerate(groupby(rows, key=lambda row: row.task)):
        if number:
            yield None
        for row in of_task:
            step = f"{row.step + 1} {'last' if row.last else row.skill}"
            counts = (f"{row.reached:,}", f"{row.positives:,}", f"{row.negatives:,}")
            yield task, row.split, step, row.policy or "-", *counts, _percent(row.positives, row.reached)


def _total_rows(found: Statistics) -> Iterator[list[Text] | None]:
    rows = [(row.task, row.episodes, row.executed, row.reached, row.positives, row.negatives) for row in found.totals()]
    sums = [sum(column) for column in list(zip(*rows, strict=True))[1:]]
    for name, *counts in (*rows, ("sum", *sums)):
        if name == "sum":
            yield None
        cells = (name, *(f"{value:,}" for value in counts), _percent(counts[3], counts[2]))
        yield styled(cells, "bold" if name == "sum" else "")


def _missing(found: Statistics) -> str:
    episodes = sum(block.episodes for block in found.missing)
    listed = [block.key.path for block in found.missing[:6]]
    names = ", ".join(listed) + (", ..." if len(found.missing) > len(listed) else "")
    return (
        f"not counted: {len(found.missing)} blocks with {episodes:,} episodes that are not on this machine ({names}). "
        f"{found.fix[:1].upper()}{found.fix[1:]}"
    )


def _print_paper(comparison: Comparison, release: str) -> None:
    numbers = tuple(f"{source} {name}" for source in ("paper", "ours") for name in ("+", "-", "rows", "% +"))
    sums = ("paper rows", "ours rows")
    rows = [
        *map(_paper_cells, comparison.tasks),
        None,
        styled(_paper_cells(comparison.total), "bold"),
        *map(_paper_cells, comparison.earlier),
        None,
        styled(_paper_cells(comparison.executed), "bold"),
    ]
    title = f"the paper's Table 2 beside {release}"
    if hidden := print_table(("", *numbers), rows, title=title, right=numbers, optional=sums):
        line(f"no room for {', '.join(sorted(hidden))}; --json has every number", "dim")
    for remark in comparison.remarks:
        line(f"- {remark}")


def _paper_cells(row: PaperRow) -> tuple[str, ...]:
    return (row.name, *_counts(row.paper), *_counts(row.ours))


def _counts(counts: Counts | None) -> tuple[str, ...]:
    if counts is None:
        return ("",) * 4
    share = _percent(counts.positives, counts.rows)
    return (f"{counts.positives:,}", f"{counts.negatives:,}", f"{counts.rows:,}", share)


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f}" if whole else "-"
