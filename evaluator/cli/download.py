"""``rema download``: fetch a release, or a part of it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from evaluator.cli.options import block_options, json_option, release_argument, sources_option
from evaluator.cli.output import line, print_answer, print_table

if TYPE_CHECKING:
    from rema_data.download import DownloadReport

__all__ = ["download"]


@click.command()
@release_argument
@block_options
@sources_option
@click.option("--jobs", type=click.IntRange(1, 64), default=8, show_default=True, help="Files at a time.")
@click.option("--manifest", type=click.Path(path_type=Path), metavar="FILE", help="Of a release not published here.")
@click.option("--offline", is_flag=True, help="Ask only folders of this machine. REMA_OFFLINE=1 does the same.")
@click.option("--verify", is_flag=True, help="Rehash the files that are here, and fetch damaged ones again.")
@click.option("--dry-run", is_flag=True, help="Print what would be fetched, and touch nothing.")
@json_option
def download(release: str | None, verify: bool, as_json: bool, **options: Any) -> None:
    """Fetch RELEASE (the newest by default), or a part of it, into REMA_HOME.

    Every file is checked by its sha256 before it gets its name. A download that was stopped goes on at the byte where
    it stopped: run the same command again.

    Sources are asked in this order: those named by --source, the folders of this checkout or package, the mirrors that
    the manifest names. Where one fails, the next is asked.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.download import download as fetch

    with StderrProgress(in_bytes=True) as progress:
        report = fetch(release, progress=progress, verify=verify, **options)
    print_answer(report, as_json, partial(_print, verified=verify))


def _print(report: DownloadReport, verified: bool) -> None:
    from rich.filesize import decimal

    if report.dry_run:
        _print_plan(report)
        return
    present = f"{report.present_files} files ({decimal(report.present_bytes)}) were there"
    if report.fetched_files:
        line(f"{report.name}: {report.fetched_files} files ({decimal(report.fetched_bytes)}) fetched, {present}")
        if report.sources:
            line(f"sources: {', '.join(f'{number} from {label}' for label, number in report.sources.items())}")
    else:
        how = "rehashed, all right" if verified else "with the right sizes; --verify rehashes them"
        line(f"{report.name}: nothing to fetch, {present}, {how}")
    line(str(report.path))


def _print_plan(report: DownloadReport) -> None:
    """A dry run: one row a block, the sum, and where it would come from."""
    from rich.filesize import decimal

    missing = decimal(report.bytes - report.present_bytes)
    rows: list[tuple[str, ...] | None] = []
    for row in report.blocks:
        fetched = decimal(row.missing_bytes) if row.missing_files else "here"
        origin = row.source or ("nowhere" if row.missing_files else "")
        rows.append((row.block, str(row.files), decimal(row.bytes), fetched, origin))
    rows += [None, ("total", str(report.files), decimal(report.bytes), missing, "")]
    numbers = ("files", "size", "to fetch")
    title = f"{report.name} ({report.sha256[:12]})"
    print_table(("block", *numbers, "from"), rows, title=title, right=numbers)
    line(f"{missing} of {decimal(report.bytes)} would be fetched into {report.root}")
    line(f"sources, in order: {', '.join(report.asked) or 'none'}")
