"""What ``rema evaluate`` and ``rema merge`` print at their end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.text import Text

from evaluator.cli.output import console, line, plain, print_facts, print_json, print_table
from evaluator.statistics import format_interval, format_rate, percent

if TYPE_CHECKING:
    from evaluator.run.cells import CellScore, SuiteScore

__all__ = ["audit_texts", "print_result"]

_BAR_WIDTH = 30
_PHASES = ("observe", "infer", "simulate", "audit")


def print_result(summary: dict[str, Any], folder: Path, as_json: bool, *, over_suite: bool = False) -> None:
    """Print the summary of a run on stdout: as a JSON object alone, or as tables for people.

    A run over a suite has a score by axis and level in place of a rate.
    """
    score, errors = _suite_result(folder) if over_suite else (None, {})
    if as_json:
        print_json(summary if score is None else {**summary, "suite": asdict(score)})
        return
    print_facts(_facts(summary, pooled=score is None))
    if summary["failures"]:
        _print_failures(summary)
    if score is not None:
        print_score(score)
        if errors:
            line("policy errors: " + ", ".join(f"{axis} {count:,} of {of:,}" for axis, (count, of) in errors.items()))
    line(_seconds(summary))
    line(f"run folder: {folder} (`rema replay` checks it)")


def _suite_result(folder: Path) -> tuple[SuiteScore, dict[str, tuple[int, int]]]:
    from evaluator.run.cells import errors_by_axis, score
    from evaluator.run.reading import read_run

    run = read_run(folder)
    return score(run), errors_by_axis(run)


def print_score(score: SuiteScore) -> None:
    """Print the rates of a suite by axis and level, in %."""
    most = max(len(axis.cells) for axis in score.axes)
    levels = tuple(f"level {number}" for number in range(1, most + 1))
    rows = [
        (
            axis.name if axis.counts else f"({axis.name})",
            *(_cell_text(cell) for cell in axis.cells),
            *("",) * (most - len(axis.cells)),
            _mean(axis.mean, axis.interval),
        )
        for axis in score.axes
    ]
    print_table(("axis", *levels, "mean [95 %]"), rows, right=(*levels, "mean [95 %]"))
    if score.hard is None:
        line(f"hard: needs every scenario of every axis, and these lack some: {', '.join(score.lacking)}")
    else:
        line(f"hard: {_mean(score.hard, score.interval)}, the mean of the axes; those in brackets do not count")


def _mean(mean: float | None, interval: tuple[float, float] | None) -> str:
    return "" if mean is None or interval is None else f"{percent(mean)} [{format_interval(interval)}]"


def _cell_text(cell: CellScore) -> str:
    if cell.rate is not None:
        return percent(cell.rate)
    return f"{cell.successes} of {cell.measured}/{cell.of}" if cell.measured else ""


def _facts(summary: dict[str, Any], pooled: bool = True) -> Iterator[tuple[str, str | Text]]:
    privileged = " (privileged: sees the ground truth)" if summary.get("privileged") else ""
    yield "policy", f"{summary['policy']}{privileged}"
    yield "task", f"{summary['task']}, {summary['protocol']}"
    successes, eligible = summary["successes"], summary["eligible"]
    if pooled:  # the cells of a suite have rates of their own
        rate = Text(format_rate(successes, eligible), style="bold")
        yield "success rate", rate.append(" (95 %)" if eligible else " (no eligible episode)", style="dim")
    yield "successes", f"{successes:,} of {eligible:,} eligible episodes"
    if summary["policy_errors"]:
        yield "policy errors", Text(f"{summary['policy_errors']:,} (counted as failures)", style="yellow")
    if summary["infra_errors"]:
        bounds = ""
        if summary.get("success_rate_bounds"):
            low, high = (100 * bound for bound in summary["success_rate_bounds"])
            bounds = f"; the rate is in {low:.1f} .. {high:.1f} %"
        yield "infra errors", Text(f"{summary['infra_errors']:,} (not counted){bounds}", style="red")
    if summary.get("unfinished"):
        yield "not finished", Text(f"{summary['unfinished']:,} episodes: this run is partial", style="red")
    if summary.get("stopped_early"):
        yield "quick look", _quick_text(summary["stopped_early"])
    if summary.get("audit"):
        yield from (("audit", text) for text in audit_texts(summary["audit"]))
    if summary.get("isolation"):
        yield "sandbox", summary["isolation"]
    if summary["protocol"] == "end-to-end":
        for step in summary.get("funnel", ()):
            passed = format_rate(step["succeeded"], step["attempted"])
            yield (
                f"step {step['step'] + 1}",
                f"{step['succeeded']:,} of {step['attempted']:,} that reached it, {passed}",
            )


def _quick_text(look: dict[str, Any]) -> str:
    """The comparison that ended a quick run."""
    low, high = (100 * end for end in look["difference_interval"])
    link = "against" if look["verdict"] == "undecided" else "than"
    return (
        f"{look['verdict']} {link} {look['against']} on {look['pairs']:,} scenarios: the difference is in "
        f"{low:+.1f} .. {high:+.1f} points at every look; no rank"
    )


def audit_texts(audit: dict[str, Any]) -> Iterator[Text]:
    """The audit of a run, with the upper ends of the 95 % intervals."""
    for what, repeated in (("action", "re-run"), ("outcome", "simulated again")):
        count, flips = audit[f"{what}s"], audit[f"{what}_flips"]
        bound = f"95 % upper bound {100 * audit[f'{what}_flips_ci95'][1]:.1f} %"
        yield plain(f"{count:,} {what}s {repeated}: {flips:,} differed ({bound})", "red" if flips else "")
    if audit["lost"]:
        yield plain(f"{audit['lost']:,} could not be repeated", "yellow")


def _print_failures(summary: dict[str, Any]) -> None:
    block = "#" if console().options.ascii_only else "█"
    counts = sorted(summary["failures"].items(), key=lambda item: (-item[1], item[0]))
    largest = counts[0][1] or 1
    rows = []
    for label, count in counts:
        bar = Text(block * max(1, round(_BAR_WIDTH * count / largest)) if count else "", style="red")
        share = f"{100 * count / summary['eligible']:.1f}" if summary["eligible"] else ""
        rows.append((label, f"{count:,}", share, bar))
    numbers = ("episodes", "% of eligible")
    print_table(("failure", *numbers, ""), rows, right=numbers, optional=("",))


def _seconds(summary: dict[str, Any]) -> str:
    seconds = summary["seconds"]
    spent = {name: seconds[name] for name in _PHASES if name in seconds}
    spent["other"] = max(0.0, seconds["total"] - sum(spent.values()))
    phases = " + ".join(f"{name} {value:.1f}" for name, value in spent.items())
    speed = summary.get("episodes_per_second")
    rate = "" if speed is None else f", {speed:,.1f} episodes/s"
    return f"{phases} = {seconds['total']:.1f} s{rate}, {summary['workers']} workers"
