"""The environment variables that name folders. A relative one is meant from where the process began."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["HOME", "MANIFESTS", "folder_of", "pin"]

HOME = "REMA_HOME"
MANIFESTS = "REMA_MANIFESTS"


def folder_of(variable: str) -> Path | None:
    """The folder that a variable names, absolute from the first look on; None where it names none."""
    text = os.environ.get(variable)
    if not text:
        return None
    path = Path(os.path.expanduser(text))
    if not path.is_absolute():
        path = path.absolute()
        os.environ[variable] = str(path)
    return path


def pin() -> None:
    """Make the folders of all variables absolute, for this process and for those that it starts."""
    for variable in (HOME, MANIFESTS):
        folder_of(variable)
