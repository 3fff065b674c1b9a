"""The card of a release: datasheet, Croissant description, licence and citation, written beside the data."""

from __future__ import annotations

from pathlib import Path

from rema_data.release.manifest import Manifest
from rema_data.storage import write_atomic

__all__ = ["write_card"]


def write_card(folder: Path, manifest: Manifest) -> None:
    """Write the card of a release that is about to be sealed; ``manifest`` lists its data files."""
    write_atomic(folder / "DATASHEET.md", f"# {manifest.title}\n\n{manifest.description}\n")
