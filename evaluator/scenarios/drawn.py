"""What was drawn of a list so far, on disk: drawing a list takes hours, and goes on where it was stopped.

``VERSION/.TASK_SPLIT.drawing/IDENTITY/NAME.parquet`` holds some scenarios of one cell, as a list of their own, and
``NAME.json``, written after it, its sha256 and how many scenarios were drawn again. The identity is that of the code
that draws: what other code drew is not used.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

from evaluator.scenarios.generation import Drawn
from evaluator.scenarios.table import decode_list, encode_list
from rema_data.storage import write_atomic

__all__ = ["keep", "kept", "work_folder"]


def work_folder(manifest: Path, task: str, split: str) -> Path:
    """Where the parts of a list lie until all of it is drawn."""
    return manifest.parent / f".{task}_{split}.drawing"


def keep(folder: Path, name: str, drawn: list[Drawn]) -> None:
    """Write a part; StorageError where the disk is full or may not be written."""
    own = [dataclasses.replace(one.scenario, index=n) for n, one in enumerate(drawn)]
    payload = encode_list(own)
    write_atomic(folder / f"{name}.parquet", payload)
    note = {"sha256": hashlib.sha256(payload).hexdigest(), "redrawn": [one.redrawn for one in drawn]}
    write_atomic(folder / f"{name}.json", json.dumps(note) + "\n")


def kept(folder: Path, name: str, task: str, split: str) -> list[Drawn] | None:
    """A part that was written before, its scenarios numbered from 0; None where it is missing or damaged."""
    try:
        note = json.loads((folder / f"{name}.json").read_bytes())
        payload = (folder / f"{name}.parquet").read_bytes()
        if hashlib.sha256(payload).hexdigest() != note["sha256"]:
            return None
        scenarios = decode_list(payload, len(note["redrawn"]), task, split)
        return [Drawn(*pair) for pair in zip(scenarios, note["redrawn"], strict=True)]
    except (OSError, ValueError, KeyError, TypeError):
        return None
