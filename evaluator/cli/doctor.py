"""``rema doctor``: versions, folders, caches and reading speed of this machine."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import click

from rema_data.errors import IntegrityError

if TYPE_CHECKING:
    from rich.table import Table

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

    console = Console()
    console.print(
        _table(
            "versions",
            ("package", "installed", "wanted", ""),
            (
                (item.name, item.version or "-", item.wanted, "" if item.ok else "out of range")
                for item in found.versions
            ),
        )
    )
    home = found.home
    writable = "writable" if home.writable else "not writable"
    console.print(Text(f"REMA_HOME is {home.path} ({writable}, {home.free_bytes / 1e9:,.1f} GB free)"), soft_wrap=True)
    if found.releases:
        console.print(
            _table(
                "releases",
                ("name", "identity", "blocks", "MB", "folder"),
                (
                    (item.name, item.identity, f"{item.blocks}/{item.blocks_total}", _megabytes(item.bytes), item.path)
                    for item in found.releases
                ),
                right=("blocks", "MB"),
            )
        )
    if found.disposable:
        console.print(
            _table(
                "decoded caches and partial downloads",
                ("release", "state", "MB", "folder"),
                ((item.release or "-", item.state, _megabytes(item.bytes), item.path) for item in found.disposable),
                right=("MB",),
            )
        )
    if found.speeds:
        console.print(
            _table(
                f"random reads, {found.tested}",
                ("batch", "of", "samples/s"),
                ((item.delivery, str(item.batch_size), f"{item.samples_per_s:,.0f}") for item in found.speeds),
                right=("of", "samples/s"),
            )
        )
    for text in found.problems:
        console.print(Text(f"problem: {text}", style="red"), soft_wrap=True)
    for text in found.advice:
        console.print(Text(f"advice: {text}", style="yellow"), soft_wrap=True)
    if not found.problems:
        console.print(Text("nothing is wrong", style="green"))


def _megabytes(size: int) -> str:
    return f"{size / _MB:,.1f}"


def _table(title: str, names: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[str] = ()) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    for name in names:
        table.add_column(name, justify="right" if name in right else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table
