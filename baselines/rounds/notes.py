"""Two small files beside the networks of a recursion, written by every process that works on it.

::

    stages.json      what every stage took on the machine that finished it
    players.json     which networks each round was collected with: the sha256 of their weights
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from filelock import FileLock

from rema_data.errors import IntegrityError
from rema_data.storage import storage_errors, write_atomic

__all__ = ["PLAYERS", "STAGES", "note", "read_notes"]

STAGES, PLAYERS = "stages.json", "players.json"


def read_notes(path: Path) -> dict[str, Any]:
    """What a file of notes holds; nothing where it is not there.

    Raises
    ------
    IntegrityError
        It is not JSON.
    """
    try:
        with storage_errors(path):
            content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return dict(content)
    except (ValueError, TypeError) as error:
        raise IntegrityError(
            f"{path} cannot be read: {error}", hint="restore it, or delete it: its notes are then lost", path=str(path)
        ) from error


def note(path: Path, key: str, value: Any) -> None:
    """Enter a note, or replace it, whoever else writes into the file meanwhile.

    Raises
    ------
    IntegrityError
        The file is not JSON.
    StorageError
        It may not be written.
    """
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(path.with_name(f".{path.name}.lock")):  # held for milliseconds: wait for it
            write_atomic(path, json.dumps(read_notes(path) | {key: value}, indent=1) + "\n")
