"""``rema import``: an exported release, brought back."""

from __future__ import annotations

from pathlib import Path

import click

from evaluator.cli.options import json_option
from evaluator.cli.output import line, print_json

__all__ = ["import_"]


@click.command(name="import")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE_OR_FOLDER...")
@click.option("--format", "format_", metavar="NAME", help="Format of the files.  [default: the one that they name]")
@click.option(
    "--output",
    "root",
    default=Path("releases"),
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of releases.",
)
@click.option("--name", help="Of the new release.  [default: that of the exported one]")
@json_option
def import_(sources: tuple[Path, ...], format_: str | None, root: Path, name: str | None, as_json: bool) -> None:
    """Make a release of what `rema export` wrote: the same one, to the last byte, where nothing was changed.

    Where something was changed, or blocks were left out, the release gets an identity of its own, and the differences
    are printed.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.convert import import_release

    with StderrProgress() as progress:
        imported = import_release(sources, root, name, format_, progress=progress)
    release, original = imported.release, imported.original
    counts = release.manifest.counts
    if as_json:
        print_json(
            {
                "release": release.manifest.name,
                "path": str(release.path),
                "sha256": release.manifest.sha256,
                "identical": imported.identical,
                "original": {"release": original.name, "sha256": original.sha256},
                "differences": imported.differences,
                "notes": imported.notes,
                "counts": counts,
            }
        )
        return
    line(f"{release.path}: {counts['episodes']:,} episodes, {counts['steps']:,} steps")
    if imported.identical:
        line(f"identical to the exported {original.name} ({original.sha256})")
    else:
        line(f"its identity is {release.manifest.sha256}")
        line(f"it differs from the exported {original.name} ({original.sha256}):")
        for difference in imported.differences:
            line(f"  {difference}")
        line(f"check it: rema verify {release.path}")
    for text in imported.notes:
        line(f"note: {text}")
