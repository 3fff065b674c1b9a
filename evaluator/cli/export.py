"""``rema export``: a release in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from evaluator.cli.options import block_options, json_option, release_argument
from evaluator.cli.output import print_json, print_table

__all__ = ["export"]


@click.command()
@release_argument
@click.option(
    "--format",
    "format_",
    default="hdf5",
    show_default=True,
    metavar="NAME",
    help="hdf5 (robomimic's layout), lerobot, minari, rlds or hf (Hugging Face); packages may add others.",
)
@click.option(
    "--output", "target", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the files."
)
@block_options
@click.option(
    "--maps",
    type=click.Choice(["metres", "quantised"]),
    default="metres",
    show_default=True,
    help="Heights as float32, or as the stored uint16.",
)
@click.option("--next-obs", is_flag=True, help="Also what is seen one step later, for offline reinforcement learning.")
@json_option
def export(
    release: str | None, format_: str, target: Path, maps: Any, next_obs: bool, as_json: bool, **blocks: Any
) -> None:
    """Write RELEASE in another format, one file or folder a task; `rema import` brings it back.

    RELEASE is a name or a folder; by default the newest release on this machine.
    """
    from evaluator.cli.progress import StderrProgress
    from rema_data.convert import ExportOptions, export_release
    from rema_data.release.folder import find_release

    found = find_release(release)
    with StderrProgress() as progress:
        files = export_release(found, target, format_, ExportOptions(maps, next_obs), progress=progress, **blocks)
    numbers = ("episodes", "steps", "bytes")
    if as_json:
        rows = [
            {"path": str(file.path), "new": file.new, **{name: getattr(file, name) for name in numbers}}
            for file in files
        ]
        about = {"release": found.manifest.name, "sha256": found.manifest.sha256, "format": format_, "maps": maps}
        print_json({**about, "files": rows})
        return
    print_table(
        ("file", *numbers, "bytes/step", ""),
        (
            (
                str(file.path),
                *(f"{getattr(file, name):,}" for name in numbers),
                f"{file.bytes / file.steps if file.steps else 0:,.0f}",
                "" if file.new else "was there already",
            )
            for file in files
        ),
        right=(*numbers, "bytes/step"),
    )
