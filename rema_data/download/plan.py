"""What a download has to fetch (files that are asked for, present and missing), and the report of what it has done."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.filesize import decimal

from rema_data.download.part import SUFFIX
from rema_data.download.sources import Source
from rema_data.errors import StorageError
from rema_data.interrupts import check
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, FileEntry
from rema_data.storage import file_sha256

__all__ = ["BlockPlan", "DownloadReport", "Plan", "check_space", "make_plan"]

WHOLE = "(release)"
"""Stands for the files that belong to no block: datasheet and the like."""


@dataclass(frozen=True, slots=True)
class BlockPlan:
    """Files of one block."""

    block: str  # its path, or ``(release)`` for the files that belong to no block
    files: int
    bytes: int
    missing_files: int  # not here yet
    missing_bytes: int
    source: str  # the first source that is asked for what is missing


@dataclass(frozen=True, slots=True)
class DownloadReport:
    """The result of a download."""

    name: str
    sha256: str
    root: Path  # the folder of releases; the release's own folder is ``path``
    files: int  # what was asked for
    bytes: int
    present_files: int  # what of it was there already
    present_bytes: int
    fetched_files: int  # what was not, and is there now (nothing in a dry run)
    fetched_bytes: int
    # what came from the sources: less where an earlier run had begun, more where bytes were thrown away
    moved_bytes: int
    sources: Mapping[str, int]  # files that every source has delivered
    asked: tuple[str, ...]  # sources in the order in which they are asked
    blocks: tuple[BlockPlan, ...]  # as it was before the download
    dry_run: bool

    @property
    def path(self) -> Path:
        """The release's own folder."""
        return self.root / self.name

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return asdict(self) | {"root": str(self.root), "path": str(self.path)}


@dataclass(frozen=True, slots=True)
class Plan:
    """Wanted files of a release."""

    files: tuple[FileEntry, ...]
    missing: tuple[FileEntry, ...]  # those that are not here with their size

    @property
    def bytes(self) -> int:
        """Of all wanted files."""
        return sum(entry.bytes for entry in self.files)

    @property
    def missing_bytes(self) -> int:
        """Of the missing files."""
        return sum(entry.bytes for entry in self.missing)

    def by_block(self, sources: Sequence[Source]) -> tuple[BlockPlan, ...]:
        """The same in blocks, with the source that comes first for each."""
        blocks: dict[str, list[FileEntry]] = {}
        for entry in self.files:
            blocks.setdefault(entry.block or WHOLE, []).append(entry)
        absent = {entry.location for entry in self.missing}
        return tuple(
            _block_plan(name, entries, [entry for entry in entries if entry.location in absent], sources)
            for name, entries in blocks.items()
        )


def _block_plan(name: str, entries: list[FileEntry], missing: list[FileEntry], sources: Sequence[Source]) -> BlockPlan:
    return BlockPlan(
        name,
        len(entries),
        sum(entry.bytes for entry in entries),
        len(missing),
        sum(entry.bytes for entry in missing),
        next((source.label for source in sources if _may_have(source, missing)), "") if missing else "",
    )


def _may_have(source: Source, entries: list[FileEntry]) -> bool:
    """Whether a local folder has the files; another source may have anything."""
    folder = source.folder()
    return folder is None or all(
        any(_size(folder / place) == entry.bytes for place in source.places(entry.location)) for entry in entries
    )


def make_plan(release: ReleaseFolder, files: Iterable[FileEntry], rehash: bool = False) -> Plan:
    """What has to be done for ``files`` of a release.

    A file counts by its size once the manifest lies beside it, which is written last. Before that, what is there may
    have come with another release of the name: it counts by its sha256, as with ``rehash``.
    """
    wanted = tuple(files)
    checked = not rehash and (release.path / MANIFEST).is_file()

    def here(entry: FileEntry) -> bool:
        check()
        return release.has(entry) and (checked or file_sha256(release.file(entry)) == entry.sha256)

    return Plan(wanted, tuple(entry for entry in wanted if not here(entry)))


def check_space(root: Path, plan: Plan) -> None:
    """Raise StorageError where the missing bytes do not fit on the disk of ``root``, which need not exist yet."""
    needed = sum(entry.bytes - min(entry.bytes, _arrived(root, entry)) for entry in plan.missing)
    place = next(folder for folder in (root, *root.absolute().parents) if folder.exists())
    free = shutil.disk_usage(place).free
    if needed > free:
        raise StorageError(
            f"the download needs {decimal(needed)} at {root}, and {decimal(free)} are free there",
            hint="free some space, set REMA_HOME to a folder on another disk, or take less: --task, --round, --split",
            needed=needed,
            free=free,
            path=str(root),
        )


def _arrived(root: Path, entry: FileEntry) -> int:
    """Bytes of a file that an earlier run has left."""
    return max(0, _size(root / f"{entry.location}{SUFFIX}"))


def _size(path: Path) -> int:
    try:
        return os.stat(path).st_size
    except OSError:
        return -1
