"""``rema doctor``: versions, folders, caches and reading speed of this machine."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from rema_data.errors import IntegrityError

if TYPE_CHECKING:
    from rema_data.doctor import Diagnosis

__all__ = ["doctor"]

_MB = 1e6


@click.command()
@click.option("--seconds", default=1.0, show_default=True, type=click.FloatRange(0, 60), help="Of each reading test.")
@click.option("--check-caches", is_flag=True, help="Read every byte of the decoded caches, too.")
@click.option("--prune", is_flag=True, help="Delete caches of no use, and partial downloads.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
@click.pass_context
def doctor(ctx: click.Context, seconds: float, check_caches: bool, prune: bool, as_json: bool) -> None:
    """Check versions, the home folder, releases and caches, and read the newest release for a few seconds.

    Exit code 6 where something is wrong. --seconds 0 leaves the reading out.
    """
    from rema_data.doctor import diagnose
    from rema_data.doctor import prune as delete

    found = diagnose(seconds, lambda text: click.echo(text, err=True), check_caches)
    if prune:
        for item in delete(found.disposable):
            click.echo(f"deleted {item.path} ({item.state}, {_megabytes(item.bytes)} MB)", err=True)
        found = diagnose(0)
    if as_json:
        click.echo(json.dumps(found.to_dict(), indent=2))
    else:
        _print(found)
    if found.problems:
        ctx.exit(IntegrityError.exit_code)


def _print(found: Diagnosis) -> None:
    from rich.console import Console
    from rich.text import Text

    from evaluator.cli.tables import make_table

    console = Console()
    versions = [
        (item.name, item.version or "-", item.wanted, "" if item.ok else "out of range") for item in found.versions
    ]
    console.print(make_table(("package", "installed", "wanted", ""), versions, title="versions"))
    home = found.home
    writable = "writable" if home.writable else "not writable"
    console.print(Text(f"REMA_HOME is {home.path} ({writable}, {home.free_bytes / 1e9:,.1f} GB free)"), soft_wrap=True)
    releases = [
        (item.name, item.identity, f"{item.blocks}/{item.blocks_total}", _megabytes(item.bytes), item.path)
        for item in found.releases
    ]
    disposable = [(item.release or "-", item.state, _megabytes(item.bytes), item.path) for item in found.disposable]
    speeds = [(item.delivery, str(item.batch_size), f"{item.samples_per_s:,.0f}") for item in found.speeds]
    for title, columns, rows in (
        ("releases", ("name", "identity", "blocks", "MB", "folder"), releases),
        ("decoded caches and partial downloads", ("release", "state", "MB", "folder"), disposable),
        (f"random reads, {found.tested}", ("batch", "of", "samples/s"), speeds),
    ):
        if rows:
            console.print(make_table(columns, rows, title=title, right=("blocks", "MB", "of", "samples/s")))
    for text in found.problems:
        console.print(Text(f"problem: {text}", style="red"), soft_wrap=True)
    for text in found.advice:
        console.print(Text(f"advice: {text}", style="yellow"), soft_wrap=True)
    if not found.problems:
        console.print(Text("nothing is wrong", style="green"))


def _megabytes(size: int) -> str:
    return f"{size / _MB:,.1f}"
