"""What a format has to do, and the records that pass between it and ``outbound`` and ``inbound``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from rema_data.convert.pieces import Piece
from rema_data.progress import Progress
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry, Manifest
from rema_data.store.block import BlockKey

__all__ = ["ExportOptions", "ExportPlan", "ExportedFile", "Format", "ImportedBlock", "Maps", "Source"]

Maps = Literal["metres", "quantised"]


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What a reader of the export will find in it."""

    maps: Maps = "metres"  # float32 heights in metres, or ``quantised``: the stored uint16
    next_obs: bool = False  # also what was seen one step later, which offline reinforcement learning reads


@dataclass(frozen=True, slots=True)
class ExportedFile:
    """A file of an export."""

    path: Path
    episodes: int
    steps: int
    bytes: int
    new: bool  # False where the same export was there already


@dataclass(frozen=True, slots=True)
class ExportPlan:
    """An export that is asked for: blocks of a release, the folder for its files, and the options."""

    release: ReleaseFolder
    blocks: tuple[BlockEntry, ...]
    target: Path
    options: ExportOptions


class ImportedBlock(NamedTuple):
    """A block of an export: its pieces in the order of the episodes, to be read once."""

    key: BlockKey
    pieces: Iterator[Piece]


class Source(Protocol):
    """An export that is being read."""

    manifest: Manifest  # of the exported release
    card: dict[str, bytes]  # files of the release that belong to no block, by path
    steps: int  # how many the export holds

    def blocks(self) -> Iterator[ImportedBlock]:
        """Blocks, each once."""
        ...

    def notes(self) -> Sequence[str]:
        """What the files hold that is not imported, as far as reading the blocks has shown it."""
        ...


class Format(Protocol):
    """A format that releases are written to and read from.

    ``rema_data.testing.formats.FormatContract`` tests what it must keep.
    """

    def export(self, plan: ExportPlan, progress: Progress) -> list[ExportedFile]:
        """Write an export; each of its files appears whole or not at all.

        Raises RunMismatchError where a file of another export is in the way, IntegrityError where the release is
        damaged, and StorageError where the disk is full or may not be written.
        """
        ...

    def read(self, sources: Sequence[Path], progress: Progress) -> AbstractContextManager[Source]:
        """Open files, or folders of files, of one export; ``progress`` is for what has to be done before the blocks.

        Raises MissingFileError or InputError where there are none, or they belong to exports of different releases, and
        IntegrityError where a file is not whole or not an export; the blocks raise that too.
        """
        ...
