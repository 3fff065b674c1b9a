"""``rema export``: a release in another format."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from rema_data.schema import TASKS
from rema_data.store.block import SPLITS

__all__ = ["export"]


@click.command()
@click.argument("release", required=False)
@click.option(
    "--format",
    "format_",
    default="hdf5",
    show_default=True,
    metavar="NAME",
    help="hdf5 is robomimic's layout; packages may add others.",
)
@click.option(
    "--output", "target", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the files."
)
@click.option("--task", "tasks", multiple=True, type=click.Choice(list(TASKS)), help="Only this one (repeatable).")
@click.option("--round", "rounds", multiple=True, type=click.IntRange(min=1), help="Only this one (repeatable).")
@click.option("--split", type=click.Choice(list(SPLITS)), help="Only this one.")
@click.option(
    "--maps",
    type=click.Choice(["metres", "quantised"]),
    default="metres",
    show_default=True,
    help="Heights as float32, or as the stored uint16.",
)
@click.option("--next-obs", is_flag=True, help="Also what is seen one step later, for offline reinforcement learning.")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
def export(
    release: str | None,
    format_: str,
    target: Path,
    tasks: tuple[str, ...],
    rounds: tuple[int, ...],
    split: str | None,
    maps: Any,
    next_obs: bool,
    as_json: bool,
) -> None:
    """Write RELEASE in another format, one file a task; `rema import` brings it back.

    RELEASE is a name or a folder; by default the newest release on this machine.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.convert import ExportedFile, ExportOptions, export_release
    from rema_data.release.folder import find_release

    found = find_release(release)
    with StderrProgress() as progress:
        files = export_release(
            found,
            target,
            format_,
            ExportOptions(maps, next_obs),
            tasks=tasks or None,
            rounds=rounds or None,
            split=split,
            progress=progress,
        )
    if as_json:
        rows = [
            {"path": str(file.path), "new": file.new}
            | {name: getattr(file, name) for name in ("episodes", "steps", "bytes")}
            for file in files
        ]
        manifest = found.manifest
        answer = {"release": manifest.name, "sha256": manifest.sha256, "format": format_, "maps": maps, "files": rows}
        click.echo(json.dumps(answer, indent=2))
        return

    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 1), header_style="dim")
    table.add_column("file", overflow="fold")
    for name in ("episodes", "steps", "bytes", "bytes/step"):
        table.add_column(name, justify="right")
    table.add_column("")

    def row(file: ExportedFile) -> list[str]:
        each = file.bytes / file.steps if file.steps else 0
        return [f"{value:,.0f}" for value in (file.episodes, file.steps, file.bytes, each)]

    for file in files:
        table.add_row(Text(str(file.path)), *row(file), "" if file.new else "was there already")
    Console().print(table)
