"""``rema verify``: every byte and every invariant of a release."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rema_data.errors import InputError, IntegrityError
from rema_data.schema import TASKS
from rema_data.store.block import SPLITS

if TYPE_CHECKING:
    from rich.text import Text

    from rema_data.verify import Finding, Report

__all__ = ["verify"]

_FIXES = 10
"""So many different fixes are printed."""


@click.command()
@click.argument("release", required=False)
@click.option("--task", "tasks", multiple=True, type=click.Choice(list(TASKS)), help="Only this one (repeatable).")
@click.option("--round", "rounds", multiple=True, type=click.IntRange(min=1), help="Only this one (repeatable).")
@click.option("--split", type=click.Choice(list(SPLITS)), help="Only this one.")
@click.option("--repair", is_flag=True, help="Fetch damaged files of a downloaded release again.")
@click.option(
    "--source",
    "sources",
    multiple=True,
    metavar="URL",
    help="With --repair: folder of releases to ask first, as of `rema download` (repeatable).",
)
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
@click.pass_context
def verify(
    ctx: click.Context,
    release: str | None,
    tasks: tuple[str, ...],
    rounds: tuple[int, ...],
    split: str | None,
    repair: bool,
    sources: tuple[str, ...],
    as_json: bool,
) -> None:
    """Check every byte and every invariant of RELEASE; exit code 6 where something is wrong.

    RELEASE is a name or a folder; by default the newest release on this machine.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.release.folder import find_release
    from rema_data.verify import verify as check

    if sources and not repair:
        raise InputError(
            "--source is for --repair: nothing else is fetched", hint="add --repair, or leave --source out"
        )
    found = find_release(release)

    def run() -> Report:
        with StderrProgress() as progress:
            return check(found, tasks or None, rounds or None, split, progress)

    report = run()
    if repair and report.damaged:
        from rema_data.verify.files import repair as fetch_damaged

        fetch_damaged(found, report, sources)
        click.echo(f"fetched {len(report.damaged)} files again", err=True)
        report = run()
    if as_json:
        click.echo(json.dumps(report.to_dict(), indent=2))
    else:
        _print(report)
    if not report.ok:
        ctx.exit(IntegrityError.exit_code)


def _row(finding: Finding, root: str) -> tuple[str | Text, ...]:
    from rich.text import Text

    file = Path(finding.file)
    shown = file.relative_to(root) if file.is_relative_to(root) else file
    return Text(finding.kind, style="red"), str(shown), finding.where, finding.detail


def _print(report: Report) -> None:
    from rich.console import Console
    from rich.text import Text

    from evaluator.cli.tables import make_table

    console = Console()
    n = {name: f"{count:,}" for name, count in report.checked.items()}
    console.print(Text(f"{report.release} ({report.sha256[:12]}) in {report.root}"), soft_wrap=True)
    console.print(
        Text(
            f"{n['blocks']} blocks, {n['files']} files, {n['bytes']} bytes, {n['episodes']} episodes, {n['steps']} "
            f"steps, {n['end_effectors']} end-effector maps; compared with {n['frozen_scenes']} frozen scenes"
        )
    )
    if report.absent:
        console.print(Text(f"not downloaded, not checked: {', '.join(report.absent)}", style="yellow"))
    if report.ok:
        console.print(Text("nothing is wrong", style="green"))
        return
    console.print(
        make_table(("what", "file", "where", "detail"), (_row(finding, report.root) for finding in report.findings))
    )
    for kind, count in report.counts.items():
        listed = sum(finding.kind == kind for finding in report.findings)
        if count > listed:
            console.print(Text(f"{count - listed} more of the kind {kind}"))
    if report.unread:
        console.print(Text(f"contents not checked, or not all: {', '.join(report.unread)}", style="yellow"))
    fixes = list(dict.fromkeys(finding.fix for finding in report.findings))
    console.print(Text("to fix it:", style="bold"))
    for fix in fixes[:_FIXES]:
        console.print(Text(f"  {fix}"), soft_wrap=True)
    if len(fixes) > _FIXES:
        console.print(Text(f"  ... and {len(fixes) - _FIXES} more: rema verify --json lists them"))
