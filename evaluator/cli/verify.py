"""``rema verify``: every byte and every invariant of a release."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import block_options, json_option, release_argument, sources_option
from evaluator.cli.output import line, note, plain, print_answer, print_table
from rema_data.errors import InputError, IntegrityError

if TYPE_CHECKING:
    from rema_data.verify import Report

__all__ = ["verify"]

_FIXES = 10
"""So many different fixes are printed."""


@click.command()
@release_argument
@block_options
@click.option("--repair", is_flag=True, help="Fetch damaged files of a download again, from --source first if given.")
@sources_option
@json_option
@click.pass_context
def verify(
    ctx: click.Context, /, release: str | None, repair: bool, sources: tuple[str, ...], as_json: bool, **blocks: Any
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
            return check(found, **blocks, progress=progress)

    report = run()
    if repair and report.damaged:
        from rema_data.verify.files import repair as fetch_damaged

        fetch_damaged(found, report, sources)
        note(f"fetched {len(report.damaged)} files again")
        report = run()
    print_answer(report, as_json, _print)
    if not report.ok:
        ctx.exit(IntegrityError.exit_code)


def _print(report: Report) -> None:
    n = {name: f"{count:,}" for name, count in report.checked.items()}
    line(f"{report.release} ({report.sha256[:12]}) in {report.root}")
    line(
        f"{n['blocks']} blocks, {n['files']} files, {n['bytes']} bytes, {n['episodes']} episodes, {n['steps']} "
        f"steps, {n['end_effectors']} end-effector maps; compared with {n['frozen_scenes']} frozen scenes"
    )
    if report.absent:
        line(f"not downloaded, not checked: {', '.join(report.absent)}", "yellow")
    if report.ok:
        line("nothing is wrong", "green")
        return
    rows = []
    for finding in report.findings:
        file = Path(finding.file)
        shown = file.relative_to(report.root) if file.is_relative_to(report.root) else file
        rows.append((plain(finding.kind, "red"), str(shown), finding.where, finding.detail))
    print_table(("what", "file", "where", "detail"), rows)
    for kind, count in report.counts.items():
        listed = sum(finding.kind == kind for finding in report.findings)
        if count > listed:
            line(f"{count - listed} more of the kind {kind}")
    if report.unread:
        line(f"contents not checked, or not all: {', '.join(report.unread)}", "yellow")
    fixes = list(dict.fromkeys(finding.fix for finding in report.findings))
    line("to fix it:", "bold")
    for fix in fixes[:_FIXES]:
        line(f"  {fix}")
    if len(fixes) > _FIXES:
        line(f"  ... and {len(fixes) - _FIXES} more: rema verify --json lists them")
