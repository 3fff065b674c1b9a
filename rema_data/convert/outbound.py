"""Export: blocks of a release, in another format."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rema_data.convert.base import ExportedFile, ExportOptions, ExportPlan, Format
from rema_data.convert.formats import find_format
from rema_data.interrupts import held
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder

__all__ = ["export_release"]


def export_release(
    release: ReleaseFolder,
    target: Path,
    format: str | Format = "hdf5",
    options: ExportOptions | None = None,
    *,
    tasks: Iterable[str] | None = None,
    rounds: Iterable[int] | None = None,
    split: str | None = None,
    progress: Progress | None = None,
) -> list[ExportedFile]:
    """Write a release, or blocks of it (all by default), into the folder ``target``, created where it is missing.

    A file appears whole or not at all. Files of the same export that are there already are kept: an interrupted export
    resumes. ``format`` is by default robomimic's HDF5; the name of an installed format, or the format itself.

    Raises InputError for an unknown format, task, round or split, MissingFileError where a block is not on this
    machine, RunMismatchError where a file of another export is in the way, IntegrityError where the release is
    damaged, and StorageError where the disk is full or may not be written.
    """
    writer = find_format(format)
    blocks = release.manifest.select(tasks, rounds, split)
    release.require(blocks)
    plan = ExportPlan(release, blocks, target, options or ExportOptions())
    with held():
        return writer.export(plan, progress or Silent())
