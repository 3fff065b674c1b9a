"""What ``rema evaluate`` prints at its end."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from evaluator.statistics import format_rate

__all__ = ["audit_text", "print_result"]

_BAR_WIDTH = 30
_PHASES = ("observe", "infer", "simulate", "audit")


def print_result(summary: dict[str, Any], folder: Path, as_json: bool) -> None:
    """Print the summary of a run on stdout: as a JSON object alone, or as tables for people."""
    if as_json:
        click.echo(json.dumps(summary, indent=2))
        return
    console = Console()
    console.print()
    console.print(_facts(summary))
    if summary["failures"]:
        console.print(_failures(summary, "#" if console.options.ascii_only else "█"))
    console.print(_seconds(summary))
    console.print(Text(f"run folder: {folder} (`rema replay` checks it)"), soft_wrap=True)


def _facts(summary: dict[str, Any]) -> Table:
    table = Table(show_header=False, box=None, padding=(0, 1))
    table.add_column(justify="right", style="dim")
    table.add_column(overflow="fold")
    privileged = " (privileged: sees the ground truth)" if summary.get("privileged") else ""
    table.add_row("policy", Text(f"{summary['policy']}{privileged}"))
    table.add_row("task", Text(f"{summary['task']}, {summary['protocol']}"))
    successes, eligible = summary["successes"], summary["eligible"]
    rate = Text(format_rate(successes, eligible), style="bold")
    table.add_row("success rate", rate.append(" (95 %)" if eligible else " (no eligible episode)", style="dim"))
    table.add_row("successes", Text(f"{successes:,} of {eligible:,} eligible episodes"))
    if summary["policy_errors"]:
        table.add_row("policy errors", Text(f"{summary['policy_errors']:,} (counted as failures)", style="yellow"))
    if summary["infra_errors"]:
        bounds = ""
        if summary.get("success_rate_bounds"):
            low, high = (100 * bound for bound in summary["success_rate_bounds"])
            bounds = f"; the rate is in {low:.1f} .. {high:.1f} %"
        table.add_row("infra errors", Text(f"{summary['infra_errors']:,} (not counted){bounds}", style="red"))
    if summary.get("unfinished"):
        table.add_row("not finished", Text(f"{summary['unfinished']:,} episodes: this run is partial", style="red"))
    if summary.get("stopped_early"):
        table.add_row("quick look", Text(_look(summary["stopped_early"])))
    if summary.get("audit"):
        table.add_row("repeated", audit_text(summary["audit"]))
    if summary.get("isolation"):
        table.add_row("sandbox", Text(summary["isolation"]))
    if summary["protocol"] == "end-to-end":
        for step in summary.get("funnel", ()):
            passed = format_rate(step["succeeded"], step["attempted"])
            table.add_row(
                f"step {step['step'] + 1}",
                Text(f"{step['succeeded']:,} of {step['attempted']:,} that reached it, {passed}"),
            )
    return table


def _look(look: dict[str, Any]) -> str:
    """What a look at a run that has not ended says."""
    low, high = (100 * end for end in look["difference_interval"])
    what = look["verdict"] if look["verdict"] == "undecided" else f"{look['verdict']} than"
    against = f" against {look['against']}" if look["verdict"] == "undecided" else f" {look['against']}"
    return (
        f"{what}{against} on {look['pairs']:,} scenarios: the difference is in {low:+.1f} .. {high:+.1f} points "
        "at every look; no rank"
    )


def audit_text(audit: dict[str, Any]) -> Text:
    """What came of the repeated share of a run, with the upper ends of the 95 % intervals."""
    parts = []
    for what in ("action", "outcome"):
        count, flips = audit[f"{what}s"], audit[f"{what}_flips"]
        bound = 100 * audit[f"{what}_flips_ci95"][1]
        again = "asked for again" if what == "action" else "simulated again"
        parts.append(f"{count:,} {what}s {again}: {flips:,} differed (95 % upper bound {bound:.1f} %)")
    if audit["lost"]:
        parts.append(f"{audit['lost']:,} could not be repeated")
    flipped = audit["action_flips"] or audit["outcome_flips"]
    return Text("; ".join(parts), style="red" if flipped else "")


def _failures(summary: dict[str, Any], block: str) -> Table:
    table = Table(box=None, padding=(0, 1), title="why episodes failed", title_justify="left", title_style="dim")
    table.add_column(justify="right", header_style="dim")
    table.add_column(no_wrap=True, overflow="crop")
    table.add_column(justify="right")
    table.add_column(justify="right", style="dim")
    counts = sorted(summary["failures"].items(), key=lambda item: (-item[1], item[0]))
    largest = max((count for _, count in counts), default=0) or 1
    for label, count in counts:
        bar = Text(block * max(1, round(_BAR_WIDTH * count / largest)) if count else "", style="red")
        share = f"{100 * count / summary['eligible']:.1f} %" if summary["eligible"] else ""
        table.add_row(Text(label), bar, f"{count:,}", share)
    table.show_header = False
    return table


def _seconds(summary: dict[str, Any]) -> Text:
    seconds = summary["seconds"]
    spent = {name: seconds[name] for name in _PHASES if name in seconds}
    spent["other"] = max(0.0, seconds["total"] - sum(spent.values()))
    phases = " + ".join(f"{name} {value:.1f}" for name, value in spent.items())
    speed = summary.get("episodes_per_second")
    rate = "" if speed is None else f", {speed:,.1f} episodes/s"
    return Text(f"{phases} = {seconds['total']:.1f} s{rate}, {summary['workers']} workers")
