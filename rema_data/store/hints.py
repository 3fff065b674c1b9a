"""The repair hint of an error about a damaged file: code that knows the release passes the command in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

__all__ = ["RepairHint", "ask_verify"]

RepairHint = Callable[[Path], str]
"""Hint of an error about a file or folder of a block."""


def ask_verify(path: Path) -> str:
    """Where the release is not known: the command that says how to repair the file."""
    return "see how to repair it: `rema verify`, with the name or the folder of the release"
