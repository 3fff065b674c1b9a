"""``rema doctor``: versions, folders, caches and reading speed of this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import line, note, print_answer, print_table
from evaluator.cli.progress import StderrProgress
from rema_data.errors import IntegrityError

if TYPE_CHECKING:
    from rema_data.doctor import Diagnosis

__all__ = ["doctor"]

_MB = 1e6


@click.command()
@click.option("--seconds", default=1.0, show_default=True, type=click.FloatRange(0, 60), help="Of each reading test.")
@click.option("--check-caches", is_flag=True, help="Read every byte of the decoded caches, too.")
@click.option("--prune", is_flag=True, help="Delete caches of no use, and partial downloads.")
@json_option
@click.pass_context
def doctor(ctx: click.Context, seconds: float, check_caches: bool, prune: bool, as_json: bool) -> None:
    """Check versions, the home folder, releases and caches, and read the newest release for a few seconds.

    Exit code 6 where something is wrong. --seconds 0 leaves the reading out.
    """
    from rema_data.doctor import diagnose
    from rema_data.doctor import prune as delete

    with StderrProgress(in_bytes=True) as progress:
        found = diagnose(seconds, progress, check_caches)
    if prune:
        for item in delete(found.disposable):
            note(f"deleted {item.path} ({item.state}, {_megabytes(item.bytes)} MB)")
        found = diagnose(0)
    print_answer(found, as_json, _print)
    if found.problems:
        ctx.exit(IntegrityError.exit_code)


def _print(found: Diagnosis) -> None:
    home = found.home
    writable = "writable" if home.writable else "not writable"
    line(f"REMA_HOME is {home.path} ({writable}, {home.free_bytes / _MB / 1000:,.1f} GB free)")
    versions = [
        (item.name, item.version or "-", item.wanted, "" if item.ok else "out of range") for item in found.versions
    ]
    releases = [
        (item.name, item.identity, f"{item.blocks}/{item.blocks_total}", _megabytes(item.bytes), item.path)
        for item in found.releases
    ]
    disposable = [(item.release or "-", item.state, _megabytes(item.bytes), item.path) for item in found.disposable]
    speeds = [(item.delivery, str(item.batch_size), f"{item.samples_per_s:,.0f}") for item in found.speeds]
    for title, columns, rows in (
        ("versions", ("package", "installed", "required", ""), versions),
        ("releases", ("name", "identity", "blocks", "MB", "folder"), releases),
        ("decoded caches and partial downloads", ("release", "state", "MB", "folder"), disposable),
        (f"random reads, {found.tested}", ("batch", "of", "samples/s"), speeds),
    ):
        if rows:
            print_table(columns, rows, title=title, right=("blocks", "MB", "of", "samples/s"))
    for text in found.problems:
        line(f"problem: {text}", "red")
    for text in found.advice:
        line(f"advice: {text}", "yellow")
    if not found.problems:
        line("nothing is wrong", "green")


def _megabytes(size: int) -> str:
    return f"{size / _MB:,.1f}"
