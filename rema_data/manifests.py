"""Where the frozen facts are: scenario lists, releases, checkpoints and published numbers."""

from __future__ import annotations

import os
from pathlib import Path

from rema_data.errors import MissingFileError

__all__ = ["manifests_dir"]


def manifests_dir() -> Path:
    """Folder of the manifests.

    ``REMA_MANIFESTS`` names it where that is set; else it is ``manifests`` beside the packages of a checkout, and
    ``_manifests`` inside ``rema_data`` of an installed wheel.

    Raises
    ------
    MissingFileError
        None of them is a folder.
    """
    override = os.environ.get("REMA_MANIFESTS")
    package = Path(__file__).resolve().parent
    choices = [Path(override).expanduser()] if override else [package / "_manifests", package.parent / "manifests"]
    for folder in choices:
        if folder.is_dir():
            return folder
    searched = ", ".join(str(folder) for folder in choices)
    hint = "correct or unset REMA_MANIFESTS" if override else "install rema again: pip install --force-reinstall rema"
    raise MissingFileError(f"there is no manifests folder at {searched}", hint=hint, searched=searched)
