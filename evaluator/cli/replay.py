"""``rema replay``: check a finished run by playing it again from its recorded actions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import engine_options, json_option
from evaluator.cli.output import line, plain, print_answer, print_facts, print_table
from rema_data.errors import InfrastructureError, IntegrityError

if TYPE_CHECKING:
    from rich.text import Text

    from evaluator.replay import ReplayReport

__all__ = ["replay"]

_FINDINGS = 20
"""So many are printed; --json has all."""


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--fraction",
    type=click.FloatRange(0, 1),
    default=1.0,
    show_default=True,
    help="Share of the episodes, drawn at random, that is simulated again.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Draw the episodes of an earlier replay.  [default: new ones]")
@engine_options
@json_option
@click.pass_context
def replay(ctx: click.Context, /, run: Path, fraction: float, as_json: bool, **options: Any) -> None:
    """Check RUN, the folder of a `rema evaluate`, without its policy; exit code 6 where something is wrong.

    Every sealed byte is compared with its seal, the statistics are counted again, and the recorded actions are
    simulated again. Another simulator than the run's may give other outcomes: it confirms the run only where at most
    0.5 % of them are others, at the 95 % upper bound; otherwise the run is not verified, exit code 6.
    """
    from evaluator.api import replay as play
    from evaluator.cli.progress import StderrProgress
    from evaluator.protocol import INFRA_LIMIT

    with StderrProgress() as progress:
        report = play(run, fraction=fraction, progress=progress, **options)
    print_answer(report, as_json, _print)
    if not report.ok or not (report.verified or report.same_simulator):
        ctx.exit(IntegrityError.exit_code)
    if report.lost > INFRA_LIMIT * (report.replayed + report.lost):
        raise InfrastructureError(
            f"{report.lost} episodes could not be simulated here", hint="run the same command again", lost=report.lost
        )


def _print(report: ReplayReport) -> None:
    print_facts(_facts(report))
    for name, (recorded, here) in report.differences.items():
        line(f"{name} is {here} here, {recorded} in the run", "yellow")
    if report.ok:
        line(*_verdict(report))
        return
    rows = [(plain(one.file, "red"), one.where, one.detail) for one in report.findings[:_FINDINGS]]
    print_table(("file", "where", "what is wrong"), rows)
    if len(report.findings) > _FINDINGS:
        line(f"{len(report.findings) - _FINDINGS} more: --json lists them")


def _verdict(report: ReplayReport) -> tuple[str, str]:
    """What a replay that found nothing shows, and its colour."""
    from evaluator.protocol import FLIP_LIMIT

    if report.same_simulator:
        if not report.replayed:
            return "the files are as they were sealed; nothing was simulated again", "yellow"
        return ("nothing is wrong" if report.seed is None else "nothing is wrong in what was looked at"), "green"
    bound = f"the share of other outcomes may be {100 * report.flips_ci95[1]:.2f} % (95 % upper bound"
    if report.verified:
        return f"verified by another simulator: {bound})", "green"
    return f"not verified: {bound}, limit {100 * FLIP_LIMIT:g} %)", "red"


def _facts(report: ReplayReport) -> Iterator[tuple[str, str | Text]]:
    yield "run", f"{report.policy}, {report.task}, {report.protocol}, {report.episodes:,} episodes"
    yield "seal", report.seal
    if report.unfinished:
        yield "partial", plain(f"{report.unfinished:,} episodes have no result", "red")
    if report.infra_errors:
        yield "infra errors", plain(f"{report.infra_errors:,} episodes were lost in the run", "red")
    drawn = "" if report.seed is None else f", drawn with seed {report.seed}"
    yield "replayed", f"{report.replayed:,} episodes{drawn}"
    if report.lost:
        yield "lost here", plain(f"{report.lost:,} episodes could not be simulated", "red")
    if report.replayed:
        yield (
            "false rows" if report.same_simulator else "other rows",
            _share(report, report.different_rows, report.different_ci95[1]),
        )
        if not report.same_simulator:
            bound = f": at most {100 * report.flips_ci95[1]:.2f} % (95 %)"
            yield "flips", f"{report.flips:,} of {report.replayed:,}{bound}"
    if report.audit:
        from evaluator.cli.result import audit_texts

        yield from (("its own audit", text) for text in audit_texts(report.audit))


def _share(report: ReplayReport, count: int, high: float) -> Text:
    bound = "" if report.seed is None else f": at most {100 * high:.2f} % of all (95 %)"
    return plain(f"{count:,} of {report.replayed:,}{bound}", "red" if count and report.same_simulator else "")
