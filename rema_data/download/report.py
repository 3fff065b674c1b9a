"""What a download has done, or would do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rema_data.download.plan import BlockPlan

__all__ = ["DownloadReport"]


@dataclass(frozen=True, slots=True)
class DownloadReport:
    """The result of a download.

    Attributes
    ----------
    name, sha256 : str
        Release and its identity.
    root : Path
        The folder of releases; the release's own folder is ``root / name``.
    files, bytes : int
        What was asked for.
    present_files, present_bytes : int
        What of it was there already.
    fetched_files, fetched_bytes : int
        What was not, and is there now (nothing in a dry run).
    moved_bytes : int
        What came from the sources: less than ``fetched_bytes`` where an earlier run had begun, more where bytes had
        to be thrown away.
    sources : dict of str to int
        Files that every source has delivered.
    asked : tuple of str
        Sources in the order in which they are asked.
    blocks : tuple of BlockPlan
        As it was before the download.
    dry_run : bool
        Nothing was fetched.
    """

    name: str
    sha256: str
    root: Path
    files: int
    bytes: int
    present_files: int
    present_bytes: int
    fetched_files: int
    fetched_bytes: int
    moved_bytes: int
    sources: Mapping[str, int]
    asked: tuple[str, ...]
    blocks: tuple[BlockPlan, ...]
    dry_run: bool

    @property
    def path(self) -> Path:
        """The release's own folder."""
        return self.root / self.name

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return asdict(self) | {"root": str(self.root), "path": str(self.path)}
