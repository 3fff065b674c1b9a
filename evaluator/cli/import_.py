"""``rema import``: an exported release, brought back."""

from __future__ import annotations

import json
from pathlib import Path

import click

__all__ = ["import_"]


@click.command(name="import")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE_OR_FOLDER...")
@click.option("--format", "format_", default="hdf5", show_default=True, metavar="NAME", help="Format of the files.")
@click.option(
    "--output",
    "root",
    default=Path("releases"),
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of releases.",
)
@click.option("--name", help="Of the new release.  [default: that of the exported one]")
@click.option("--json", "as_json", is_flag=True, help="Print one object.")
def import_(sources: tuple[Path, ...], format_: str, root: Path, name: str | None, as_json: bool) -> None:
    """Make a release of what `rema export` wrote: the same one, to the last byte, where nothing was changed.

    Where something was, or where blocks were left out, the release gets an identity of its own, and what differs is
    printed.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.convert import import_release

    with StderrProgress() as progress:
        imported = import_release(sources, root, name, format_, progress=progress)
    release, original = imported.release, imported.original
    if as_json:
        answer = {
            "release": release.manifest.name,
            "path": str(release.path),
            "sha256": release.manifest.sha256,
            "identical": imported.identical,
            "original": {"release": original.name, "sha256": original.sha256},
            "differences": imported.differences,
            "notes": imported.notes,
            "counts": release.manifest.counts,
        }
        click.echo(json.dumps(answer, indent=2))
        return
    counts = release.manifest.counts
    click.echo(f"{release.path}: {counts['episodes']:,} episodes, {counts['steps']:,} steps")
    if imported.identical:
        click.echo(f"identical to the exported {original.name} ({original.sha256})")
    else:
        click.echo(f"its identity is {release.manifest.sha256}")
        click.echo(f"it differs from the exported {original.name} ({original.sha256}):")
        for difference in imported.differences:
            click.echo(f"  {difference}")
        click.echo(f"check it: rema verify {release.path}")
    for note in imported.notes:
        click.echo(f"note: {note}")
