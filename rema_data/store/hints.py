"""What an error about a damaged file says of its mending: whoever knows the release hands over the command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

__all__ = ["Mend", "ask_verify"]

Mend = Callable[[Path], str]
"""Hint of an error about a file or folder of a block."""


def ask_verify(path: Path) -> str:
    """Where the release is not known: the command that says what mends the file."""
    return "find out what mends it: `rema verify`, with the name or the folder of the release"
