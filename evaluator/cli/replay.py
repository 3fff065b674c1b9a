"""``rema replay``: check a finished run by playing it again from its recorded actions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from evaluator.cli.engine_options import engine_options
from rema_data.errors import InfrastructureError, InputError, IntegrityError

if TYPE_CHECKING:
    from rich.table import Table
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
@click.option("--public-key", type=click.Path(path_type=Path), help="Ed25519 key that must have signed the run.")
@click.option("--sign", "private_key", type=click.Path(path_type=Path), help="Ed25519 key to sign with if all is well.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
@click.pass_context
def replay(
    ctx: click.Context,
    run: Path,
    fraction: float,
    seed: int | None,
    workers: int | None,
    engine: str,
    address: str | None,
    public_key: Path | None,
    private_key: Path | None,
    as_json: bool,
) -> None:
    """Check RUN, the folder of a `rema evaluate`, without its policy; exit code 6 where something is wrong.

    Every sealed byte is compared with its seal, the statistics are counted again, and the recorded actions are
    simulated again. With another simulator than the run's, the share of flips is printed and is not an error.
    """
    from evaluator.api import replay as play
    from evaluator.cli.progress import StderrProgress
    from evaluator.protocol import INFRA_LIMIT
    from evaluator.replay import sign
    from evaluator.run.signature import read_private_key

    if private_key is not None and not fraction:
        raise InputError(
            "--sign vouches for what was simulated again, and --fraction 0 simulates nothing",
            hint="give a part, such as --fraction 0.02, or leave --fraction out",
        )
    passphrase = f"passphrase of {private_key}"
    key = None
    if private_key is not None:
        key = read_private_key(private_key, lambda: str(click.prompt(passphrase, hide_input=True, err=True)))
    with StderrProgress() as progress:
        report = play(
            run,
            fraction=fraction,
            seed=seed,
            engine=engine,
            workers=workers,
            address=address,
            public_key=public_key,
            progress=progress,
        )
    if as_json:
        click.echo(json.dumps(report.to_dict(), indent=2))
    else:
        _print(report)
    if not report.ok:
        ctx.exit(IntegrityError.exit_code)
    if report.lost > INFRA_LIMIT * (report.replayed + report.lost):
        raise InfrastructureError(
            f"{report.lost} episodes could not be simulated here", hint="run the same command again", lost=report.lost
        )
    if key is not None:
        click.echo(f"signed: {sign(run, report, key)}", err=True)


def _print(report: ReplayReport) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console()
    console.print(_facts(report))
    for name, (recorded, here) in report.differences.items():
        console.print(Text(f"{name} is {here} here, {recorded} in the run", style="yellow"), soft_wrap=True)
    if report.ok:
        console.print(Text("nothing is wrong", style="green"))
        return
    console.print(_findings(report))
    if len(report.findings) > _FINDINGS:
        console.print(Text(f"{len(report.findings) - _FINDINGS} more: --json lists them"))


def _facts(report: ReplayReport) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, padding=(0, 1))
    table.add_column(justify="right", style="dim")
    table.add_column(overflow="fold")
    table.add_row("run", Text(f"{report.policy}, {report.task}, {report.protocol}, {report.episodes:,} episodes"))
    table.add_row("root", Text(report.merkle_root))
    if report.unfinished:
        table.add_row("partial", Text(f"{report.unfinished:,} episodes have no result", style="red"))
    if report.infra_errors:
        table.add_row("infra errors", Text(f"{report.infra_errors:,} episodes were lost in the run", style="red"))
    drawn = "" if report.seed is None else f", drawn with seed {report.seed}"
    table.add_row("replayed", Text(f"{report.replayed:,} episodes{drawn}"))
    if report.lost:
        table.add_row("lost here", Text(f"{report.lost:,} episodes could not be simulated", style="red"))
    if report.replayed:
        table.add_row("false rows" if report.same_simulator else "other rows", _share(report, "different"))
        if not report.same_simulator:
            table.add_row("flips", _share(report, "flips"))
    if report.audit:
        from evaluator.cli.result import audit_text

        table.add_row("its own audit", audit_text(report.audit))
    table.add_row("signature", Text(_signature(report)))
    return table


def _share(report: ReplayReport, what: str) -> Text:
    from rich.text import Text

    count, high = (
        (report.different_rows, report.different_ci95[1])
        if what == "different"
        else (report.flips, report.flips_ci95[1])
    )
    bound = "" if report.seed is None else f": at most {100 * high:.2f} % of all (95 %)"
    return Text(f"{count:,} of {report.replayed:,}{bound}", style="red" if count and report.same_simulator else "")


def _signature(report: ReplayReport) -> str:
    if not report.signed:
        return "none"
    if report.signer is None:
        return "there is one; check it with --public-key FILE"
    wrong = any(finding.file == "run.json.sig" for finding in report.findings)
    return f"{'not ' if wrong else ''}by the key {report.signer[:16]}"


def _findings(report: ReplayReport) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("file", "where", "what is wrong"):
        table.add_column(name, overflow="fold")
    for finding in report.findings[:_FINDINGS]:
        table.add_row(Text(finding.file, style="red"), Text(finding.where), Text(finding.detail))
    return table
