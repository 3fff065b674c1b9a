"""``rema compare``: two policies on the same scenarios."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from evaluator.leaderboard.comparison import Comparison

__all__ = ["compare"]

_SHOWN = 10
_P_DIGITS = 4


@click.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option(
    "--json", "as_json", is_flag=True, help="Print everything as an object, all discordant scenarios included."
)
def compare(a: Path, b: Path, as_json: bool) -> None:
    """Compare A with B scenario by scenario: run folders of `rema evaluate` or entries of `rema submit`.

    Both must be of the same task, protocol and scenario list.
    """
    from evaluator.api import compare as compare_runs

    found = compare_runs(a, b)
    if as_json:
        click.echo(json.dumps(found.to_dict(), indent=2))
    else:
        _show(found, Console())


def _show(found: Comparison, console: Console) -> None:
    console.print(Text(f"{found.a.task}, {found.a.protocol}, {found.table.n:,} scenarios", style="bold"))
    for remark in found.remarks:
        console.print(Text(remark, style="bold red" if remark.startswith("ANOTHER SIMULATOR") else "yellow"))
    console.print(_facts(found))
    console.print(_crossed(found))
    if found.strata:
        console.print(_strata(found))
    for side, only in (("A", found.only_a), ("B", found.only_b)):
        console.print(Text(f"solved by {side} alone: {_first(only)}"), soft_wrap=True)
    if found.only_a or found.only_b:
        console.print(Text(f"look at one: {_preview(found)}", style="dim"), soft_wrap=True)


def _preview(found: Comparison) -> str:
    """The command that shows a scenario of the list that both policies met; N is left to be filled in."""
    words = ["rema", "preview"]
    for option in ("task", "split", "protocol"):
        words += [f"--{option}", str(getattr(found.a, option))]
    return f"{shlex.join(words)} --policy POLICY --scenario N"


def _facts(found: Comparison) -> Table:
    from evaluator.statistics import format_rate

    table, sides = found.table, Table(show_header=False, box=None, padding=(0, 1))
    sides.add_column(justify="right", style="dim")
    sides.add_column(overflow="fold")
    for side, run, only in (("A", found.a, table.only_a), ("B", found.b, table.only_b)):
        rate = format_rate(table.both + only, table.n)
        sides.add_row(side, Text(f"{run.policy} ({run.tag}): {rate}, {table.both + only:,}/{table.n:,}"))
    low, high = (f"{100 * end:+.2f}" for end in found.interval)
    sides.add_row("A - B", Text(f"{100 * table.difference:+.2f} points [{low}, {high}]", style="bold"))
    sides.add_row("p", Text(f"{_p(found.p)} (mid-p McNemar, two-sided; no other comparison is accounted for)"))
    sides.add_row("discordance", Text(f"{100 * table.discordance:.2f} % of the scenarios"))
    least = "no difference" if found.detectable is None else f"{100 * found.detectable:.2f} points"
    sides.add_row("detectable", Text(f"{least} with 80 % power, at this n and discordance"))
    return sides


def _crossed(found: Comparison) -> Table:
    table, crossed = found.table, _plain_table("scenarios", "B solved", "B failed")
    for number in (1, 2):
        crossed.columns[number].justify = "right"
    crossed.add_row("A solved", f"{table.both:,}", f"{table.only_a:,}")
    crossed.add_row("A failed", f"{table.only_b:,}", f"{table.neither:,}")
    return crossed


def _strata(found: Comparison) -> Table:
    from evaluator.statistics import percent

    shown = _plain_table("target", "", "n", "A %", "B %", "A - B, points", "adjusted p")
    shown.title = "by shape, size and yaw: exploratory (adjusted by Benjamini-Hochberg)"
    shown.title_justify, shown.title_style = "left", "dim"
    for number in (2, 3, 4):
        shown.columns[number].justify = "right"
    before = ""
    for row in found.strata:
        table = row.table
        low, high = (f"{100 * end:+.1f}" for end in row.interval)
        shown.add_row(
            row.by if row.by != before else "",
            row.label,
            f"{table.n:,}",
            percent(table.rate_a),
            percent(table.rate_b),
            f"{100 * table.difference:+.1f} [{low}, {high}]".replace("[", "\\["),
            _p(row.p_adjusted),
        )
        before = row.by
    return shown


def _plain_table(*columns: str) -> Table:
    table = Table(*columns, box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1))
    for column in table.columns:
        column.no_wrap = True
    return table


def _p(p: float) -> str:
    return f"< {10.0**-_P_DIGITS:.4f}" if p < 10**-_P_DIGITS else f"{p:.{_P_DIGITS}f}"


def _first(scenarios: Sequence[int]) -> str:
    if not scenarios:
        return "none"
    more = f" and {len(scenarios) - _SHOWN:,} more (--json lists them)" if len(scenarios) > _SHOWN else ""
    return f"{len(scenarios):,}: {', '.join(map(str, scenarios[:_SHOWN]))}{more}"
