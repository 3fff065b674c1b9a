"""A page of chosen episodes in one file: everything that the server would answer about them is inside it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluator.view.page import assemble
from evaluator.view.viewer import PICTURES, Viewer
from rema_data.errors import InputError
from rema_data.interrupts import check
from rema_data.progress import Progress, Silent
from rema_data.storage import write_atomic

__all__ = ["WrittenPage", "spread", "write_page"]


@dataclass(frozen=True, slots=True)
class WrittenPage:
    """A page on the disk."""

    path: Path
    size: int  # bytes
    episodes: int


def spread(rows: Sequence[int], count: int) -> list[int]:
    """``count`` of some rows at even distances, in order, or all where there are no more."""
    if count >= len(rows):
        return list(rows)
    return [rows[(2 * number + 1) * len(rows) // (2 * count)] for number in range(count)]


def write_page(
    viewer: Viewer, places: Sequence[int], path: Path, *, play: bool = False, progress: Progress | None = None
) -> WrittenPage:
    """Write a page that needs no server, no network and no other file.

    Parameters
    ----------
    viewer : Viewer
    places : sequence of int
        Rows of the table.
    path : Path
    play : bool
        Whether every step is simulated again, for its photographs and its film: some seconds a step.
    progress : Progress, optional
        Counts episodes.

    Raises
    ------
    InputError
        There is no episode to show, the file is not to be an HTML file, or Pillow is not installed.
    IntegrityError, MissingFileError
        A file of the release is damaged or missing; no page is written.
    StorageError
        The file cannot be written.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(
            f"{path} is not an HTML file", hint=f"write --output {path.with_suffix('.html')}", path=str(path)
        )
    if not places:
        raise InputError("no episode was selected", hint="drop or widen --filter")
    progress = progress or Silent()
    table = viewer.source.table
    episodes: dict[str, Any] = {}
    pictures: dict[str, str] = {}
    plays: dict[str, Any] = {}
    progress.phase("draw", len(places))
    for place in places:
        name = table.ids[place]
        episodes[name] = viewer.episode(name)
        for step in (step["step"] for step in episodes[name]["steps"] if step["action"] is not None):
            for what in PICTURES:
                png = base64.b64encode(viewer.picture(name, step, what)).decode()
                pictures[f"{name} {step} {what}"] = f"data:image/png;base64,{png}"
            if play:
                plays[f"{name} {step}"] = viewer.stills(name, step) | viewer.film(name, step)
            check()
        progress.advance(1)
    about = viewer.about() | {"episodes": len(places)}
    rows = [table.row(place) for place in places]
    recorded = {"of": len(table), "rows": rows, "episodes": episodes, "pictures": pictures, "plays": plays}
    page = assemble({"about": about, "recorded": recorded}, "img-src data:")
    write_atomic(path, page)
    return WrittenPage(path, len(page), len(places))
