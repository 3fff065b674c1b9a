"""``rema compare``: two policies on the same scenarios."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import line, print_answer, print_facts, print_table
from evaluator.protocol import PROTOCOLS

if TYPE_CHECKING:
    from evaluator.leaderboard.comparison import Comparison

__all__ = ["compare"]

_SHOWN = 10
_P_DIGITS = 4


@click.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@json_option
def compare(a: Path, b: Path, as_json: bool) -> None:
    """Compare A with B scenario by scenario: run folders of `rema evaluate` or entries of `rema submit`.

    Both must be of the same task, protocol and scenario list. --json has all discordant scenarios.
    """
    from evaluator.api import compare as compare_runs
    from evaluator.cli.progress import StderrProgress

    with StderrProgress() as progress:
        found = compare_runs(a, b, progress=progress)
    print_answer(found, as_json, _print)


def _print(found: Comparison) -> None:
    line(f"{found.a.task}, {found.a.protocol}, {found.table.n:,} scenarios", "bold")
    for remark in found.remarks:
        line(remark, "bold red" if remark.startswith("ANOTHER SIMULATOR") else "yellow")
    _print_facts(found)
    table, right = found.table, ("B solved", "B failed")
    solved = ("A solved", f"{table.both:,}", f"{table.only_a:,}")
    print_table(("scenarios", *right), (solved, ("A failed", f"{table.only_b:,}", f"{table.neither:,}")), right=right)
    if found.strata:
        _print_strata(found)
    for side, only in (("A", found.only_a), ("B", found.only_b)):
        line(f"solved by {side} alone: {_first(only)}")
    if command := _look_at_one(found):
        line(f"look at one: {command}", "dim")


def _look_at_one(found: Comparison) -> str:
    """The command that shows a scenario that one policy alone solved; POLICY and N are left to be filled in.

    `rema preview` shows the lists in force, and whole observations: of another run, its own record is shown.
    """
    from evaluator.scenarios.lists import VERSION

    differing = (*found.only_a, *found.only_b)
    if not differing:
        return ""
    if found.a.version == VERSION and found.a.protocol in PROTOCOLS:
        words = ["rema", "preview"]
        for option in ("task", "split", "protocol"):
            words += [f"--{option}", str(getattr(found.a, option))]
        return f"{shlex.join(words)} --policy POLICY --scenario N"
    run = next((run for run in (found.a, found.b) if run.kind == "run"), None)  # an entry has no table to browse
    if run is None:
        return ""
    return shlex.join(["rema", "view", str(run.source), "--episode", run.table["scenario"][differing[0]].as_py()])


def _print_facts(found: Comparison) -> None:
    from rich.text import Text

    from evaluator.statistics import format_rate

    table = found.table
    low, high = (f"{100 * end:+.2f}" for end in found.interval)
    least = "no difference" if found.detectable is None else f"{100 * found.detectable:.2f} points"
    sides = (("A", found.a, table.both + table.only_a), ("B", found.b, table.both + table.only_b))
    print_facts(
        [
            *(
                (side, f"{run.policy} ({run.tag}): {format_rate(solved, table.n)}, {solved:,}/{table.n:,}")
                for side, run, solved in sides
            ),
            ("A - B", Text(f"{100 * table.difference:+.2f} points [{low}, {high}]", style="bold")),
            ("p", f"{_p(found.p)} (mid-p McNemar, two-sided; no other comparison is accounted for)"),
            ("discordance", f"{100 * table.discordance:.2f} % of the scenarios"),
            ("detectable", f"{least} with 80 % power, at this n and discordance"),
        ]
    )


def _print_strata(found: Comparison) -> None:
    from evaluator.statistics import percent

    rows = []
    for row in found.strata:
        table = row.table
        low, high = (f"{100 * end:+.1f}" for end in row.interval)
        difference = f"{100 * table.difference:+.1f} [{low}, {high}]"
        rates = (percent(table.rate_a), percent(table.rate_b))
        rows.append((row.by, row.label, f"{table.n:,}", *rates, difference, _p(row.p_adjusted)))
    print_table(
        ("target", "", "n", "A %", "B %", "A - B, points", "adjusted p"),
        rows,
        title="by shape, size and yaw: exploratory (adjusted by Benjamini-Hochberg)",
        right=("n", "A %", "B %"),
    )


def _p(p: float) -> str:
    return f"< {10.0**-_P_DIGITS:.4f}" if p < 10**-_P_DIGITS else f"{p:.{_P_DIGITS}f}"


def _first(scenarios: Sequence[int]) -> str:
    if not scenarios:
        return "none"
    more = f" and {len(scenarios) - _SHOWN:,} more (--json lists them)" if len(scenarios) > _SHOWN else ""
    return f"{len(scenarios):,}: {', '.join(map(str, scenarios[:_SHOWN]))}{more}"
