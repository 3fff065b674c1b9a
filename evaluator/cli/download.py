"""``rema download``: fetch a release, or a part of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rema_data.schema import TASKS

if TYPE_CHECKING:
    from rich.console import Console

    from rema_data.download import DownloadReport

__all__ = ["download"]


@click.command()
@click.argument("release", required=False)
@click.option("--task", "tasks", multiple=True, type=click.Choice(list(TASKS)), help="Only this task (repeatable).")
@click.option("--round", "rounds", multiple=True, type=click.IntRange(min=1), help="Only this round (repeatable).")
@click.option("--split", type=click.Choice(["train", "val"]), help="Only this split.")
@click.option(
    "--source",
    "sources",
    multiple=True,
    metavar="URL",
    help="Folder of releases to ask first: a path, file://, https://, s3://, ... (repeatable, in order).",
)
@click.option("--jobs", type=click.IntRange(1, 64), default=8, show_default=True, help="Files at a time.")
@click.option("--manifest", type=click.Path(path_type=Path), metavar="FILE", help="Of a release not published here.")
@click.option("--offline", is_flag=True, help="Ask only folders of this machine. REMA_OFFLINE=1 does the same.")
@click.option("--dry-run", is_flag=True, help="Print what would be fetched, and touch nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
def download(
    release: str | None,
    tasks: tuple[str, ...],
    rounds: tuple[int, ...],
    split: str | None,
    sources: tuple[str, ...],
    jobs: int,
    manifest: Path | None,
    offline: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Fetch RELEASE (the newest by default), or a part of it, into REMA_HOME.

    Every file is checked by its sha256 before it gets its name. A download that was stopped goes on at the byte where
    it stopped: run the same command again.

    Sources are asked in this order: those named by --source, the folders of this checkout or package, the mirrors that
    the manifest names. Where one fails, the next is asked.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.download import download as fetch

    with StderrProgress(in_bytes=True) as progress:
        report = fetch(
            release,
            tasks=tasks or None,
            rounds=rounds or None,
            split=split,
            sources=sources,
            jobs=jobs,
            offline=offline,
            dry_run=dry_run,
            progress=progress,
            manifest=manifest,
        )
    if as_json:
        click.echo(json.dumps(report.to_dict(), indent=2))
    else:
        _print(report)


def _print(report: DownloadReport) -> None:
    from rich.console import Console
    from rich.filesize import decimal
    from rich.text import Text

    console = Console()
    present = f"{report.present_files} files ({decimal(report.present_bytes)}) were there"
    if report.dry_run:
        _print_plan(report, console)
        missing = report.bytes - report.present_bytes
        lines = [f"{decimal(missing)} of {decimal(report.bytes)} would be fetched into {report.root}"]
        lines += [f"sources, in order: {', '.join(report.asked) or 'none'}"]
    elif report.fetched_files:
        origin = ", ".join(f"{number} from {label}" for label, number in report.sources.items())
        lines = [f"{report.name}: {report.fetched_files} files ({decimal(report.fetched_bytes)}) fetched, {present}"]
        lines += [f"sources: {origin}"] if origin else []
        lines += [str(report.path)]
    else:
        lines = [f"{report.name}: nothing to fetch, {present}", str(report.path)]
    for line in lines:
        console.print(Text(line), soft_wrap=True)


def _print_plan(report: DownloadReport, console: Console) -> None:
    """The table of a dry run: one row a block."""
    from rich.filesize import decimal

    from evaluator.cli.tables import make_table

    rows = []
    for row in report.blocks:
        fetched = decimal(row.missing_bytes) if row.missing_files else "here"
        origin = row.source or ("nowhere" if row.missing_files else "")
        rows.append((row.block, str(row.files), decimal(row.bytes), fetched, origin))
    numbers = ("files", "size", "to fetch")
    title = f"{report.name} ({report.sha256[:12]})"
    table = make_table(("block", *numbers, "from"), rows, title=title, right=numbers, no_wrap=numbers)
    table.add_section()
    missing = decimal(report.bytes - report.present_bytes)
    table.add_row("total", str(report.files), decimal(report.bytes), missing, "")
    console.print(table)
