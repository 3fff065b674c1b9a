"""``rema stats``: positives and negatives of a release, and the values of its maps and actions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import block_options, json_option, release_argument, where_option
from evaluator.cli.output import line, print_json, print_table, styled
from rema_data.errors import InputError

if TYPE_CHECKING:
    from rich.text import Text

    from rema_data.release.folder import ReleaseFolder
    from rema_data.statistics.count import AxisCount, Statistics, StepCount
    from rema_data.statistics.paper import Comparison, Counts, PaperRow
    from rema_data.statistics.values import ValueStatistics

__all__ = ["stats"]


@click.command()
@release_argument
@block_options
@where_option
@click.option("--values", is_flag=True, help="Mean, deviation, range and quantiles of maps and actions, too.")
@click.option("--check-paper", is_flag=True, help="Beside the upper half of the paper's Table 2.")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE.png", help="Draw the data by round.")
@json_option
def stats(
    release: str | None,
    where: str | None,
    values: bool,
    check_paper: bool,
    plot: Path | None,
    as_json: bool,
    **blocks: Any,
) -> None:
    """Count positives and negatives of RELEASE by round, task, split and step.

    RELEASE is a name or a folder; by default the newest release on this machine. A condition names columns of both
    tables; those of the episode that a step has, too, are episode_success and episode_failure. --values is of every
    executed step that is counted.
    """
    from rema_data.release.folder import find_release
    from rema_data.statistics.count import count
    from rema_data.statistics.paper import compare

    if check_paper and (where is not None or any(blocks.values())):
        raise InputError("the paper's table is of a whole release", hint="leave --check-paper out, or the selection")
    folder = find_release(release)
    found = count(folder, **blocks, where=where)
    comparison = compare(found) if check_paper else None
    of_values = _values(folder, blocks, where) if values else None
    if plot is not None:
        from rema_data.statistics.plot import plot_rounds

        plot_rounds(found, plot)
    if as_json:
        more = {"paper": comparison, "values": of_values}
        print_json(found.to_dict() | {name: part.to_dict() for name, part in more.items() if part is not None})
        return
    _print(found)
    if of_values is not None:
        _print_values(of_values)
    if comparison is not None:
        _print_paper(comparison, found.release)
    if plot is not None:
        line(str(plot))


def _values(folder: ReleaseFolder, blocks: dict[str, Any], where: str | None) -> ValueStatistics:
    from evaluator.cli.progress import StderrProgress
    from rema_data.loader.release import Release

    with StderrProgress() as progress:
        return Release(folder, progress=progress).steps(**blocks, where=where, which="all").statistics(progress)


def _print_values(found: ValueStatistics) -> None:
    numbers = ("mean", "std", "min", "q01", "q99", "max")
    rows = [
        (row.name, row.unit, f"{row.count:,}", *(f"{getattr(row, name):.6g}" for name in numbers))
        for row in found.channels
    ]
    print_table(
        ("values", "unit", "count", *numbers),
        rows,
        title=f"maps and actions of {found.steps:,} steps; q01 and q99 are quantiles",
        right=("count", *numbers),
        optional=("count", "q01", "q99"),
    )


def _print(found: Statistics) -> None:
    title = f"{found.release} ({found.sha256[:12]})" + ("" if found.where is None else f" where {found.where}")
    if found.steps:
        counts = ["reached", "+", "-", "% +"]
        for number, rows in groupby(found.steps, key=lambda row: row.round):
            columns = ("task", "split", "step", "policy", *counts)
            print_table(columns, _step_rows(rows), title=f"{title}, round {number}", right=counts)
        counts = ["episodes", "steps", "last steps", "+", "-", "% +"]
        title_of_sums = "all rounds and splits; + and - of the last steps"
        print_table(("task", *counts), _total_rows(found), title=title_of_sums, right=counts)
        if found.axes:
            counts = ["episodes", "last steps", "+", "-", "% +"]
            title_of_axes = "by what is varied in the last step, all levels together"
            print_table(("task", "axis", *counts), _axis_rows(found.axes), title=title_of_axes, right=counts)
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


def _axis_rows(axes: Iterable[AxisCount]) -> Iterator[tuple[str, ...] | None]:
    for number, (task, of_task) in enumerate(groupby(axes, key=lambda row: row.task)):
        if number:
            yield None
        for axis, levels in groupby(of_task, key=lambda row: row.axis):
            rows = [(row.episodes, row.reached, row.positives, row.negatives) for row in levels]
            sums = [sum(column) for column in zip(*rows, strict=True)]
            yield task, axis or "clean", *(f"{value:,}" for value in sums), _percent(sums[2], sums[1])


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
