"""A release as a folder for a dataset repository: a source of ``rema download``, and what ``rema verify`` checks.

::

    README.md  LICENSE  CITATION.cff  croissant.json  SHA256SUMS  .gitattributes
    rema-v1/                        the release, as it was sealed
    rema-v1-round-1/                blocks that it shares with an earlier one
    viewer/grasp/train-round-1.parquet
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

from rema_data import interrupts
from rema_data.convert.huggingface import steps_path, write_steps
from rema_data.convert.pieces import Piece, read_pieces
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.progress import Progress, Silent
from rema_data.publish.card import VIEWER, dataset_card
from rema_data.publish.folder import Published, check_repository, publication
from rema_data.release.croissant import croissant
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST
from rema_data.storage import file_sha256, new_file, write_atomic
from rema_data.store.block import BlockReader

__all__ = ["publish_release"]

_SHOWN = ("LICENSE", "CITATION.cff")
"""Files of the release that hosts look for at the top of a repository."""


def publish_release(
    release: ReleaseFolder,
    target: Path,
    repository: str = "",
    *,
    viewer: bool = True,
    progress: Progress | None = None,
) -> Published:
    """Write a whole release into the new folder ``target``.

    ``repository``, ``ORG/NAME``, goes into the commands of the card. ``viewer``: also write the steps with their maps
    in metres as Parquet, which the hub shows and ``datasets`` loads: about as many bytes again as the release has.

    Raises InputError for a name that no repository can have, MissingFileError where a block is not on this machine,
    IntegrityError where a file is not the sealed one, RunMismatchError where ``target`` holds something, and
    StorageError where the disk is full or may not be written. ``target`` is then as it was before.
    """
    manifest, sink = release.manifest, progress or Silent()
    name = check_repository(repository) if repository else f"ORG/{manifest.name}"
    release.require(manifest.blocks)
    with interrupts.held(), publication(target) as folder:
        _copy(release, folder, sink)
        if viewer:
            _write_viewer(release, folder / VIEWER, sink)
        for shown in _SHOWN:
            shutil.copyfile(folder / manifest.name / shown, folder / shown)
        version = min(release.block(block).version() for block in manifest.blocks)
        description = croissant(manifest, beside=True, version=version)
        write_atomic(folder / "croissant.json", json.dumps(description, indent=1) + "\n")
        write_atomic(folder / "README.md", dataset_card(manifest, name, viewer))
    files = [path for path in target.rglob("*") if path.is_file()]
    return Published(target, "dataset", len(files), sum(path.stat().st_size for path in files))


def _copy(release: ReleaseFolder, folder: Path, progress: Progress) -> None:
    manifest = release.manifest
    progress.phase("copy", len(manifest.files))
    for entry in manifest.files:
        interrupts.check()
        source, copy = release.file(entry), folder / entry.location
        if not release.has(entry):
            raise MissingFileError(
                f"{source} is not there, or has another size", hint=release.repair.at(source), path=str(source)
            )
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, copy)
        if file_sha256(copy) != entry.sha256:
            raise IntegrityError(
                f"{source} is not the file that was sealed: nothing was published",
                hint=release.repair.at(source),
                path=str(source),
            )
        progress.advance(1)
    write_atomic(folder / manifest.name / MANIFEST, manifest.to_bytes())


def _write_viewer(release: ReleaseFolder, folder: Path, progress: Progress) -> None:
    progress.phase("viewer", sum(block.steps for block in release.manifest.blocks))
    for block in release.manifest.blocks:
        with new_file(folder / steps_path(block.key)) as file:
            write_steps(file, _pieces(release.block(block), progress), "metres", release.manifest.schema_version)


def _pieces(block: BlockReader, progress: Progress) -> Iterator[Piece]:
    for piece in read_pieces(block):
        interrupts.check()
        yield piece
        progress.advance(piece.steps.num_rows)
