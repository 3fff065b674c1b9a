"""``run.json``: read, checked for its shape, and written as the same bytes for the same content."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evaluator.policy.named import policy_names
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.storage import storage_errors

__all__ = [
    "RUN_FILE",
    "RUN_FORMAT",
    "encode_header",
    "isolation_level",
    "read_header",
    "resume_command",
]

RUN_FILE = "run.json"
RUN_FORMAT = 1
_FIELDS = {"format": int, "identity": dict, "policy": dict, "episodes": int, "salt": str, "segments": list}
_OPTIONAL = {"seal": dict}


def encode_header(header: dict[str, Any]) -> str:
    """Content of ``run.json``."""
    return json.dumps(header, indent=2) + "\n"


def read_header(folder: Path) -> tuple[dict[str, Any], bytes]:
    """Content of a run's ``run.json``, and its bytes.

    Raises
    ------
    MissingFileError
        There is none.
    IntegrityError
        It is not a run header of this version.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        raise MissingFileError(
            f"{folder} holds no run: it has no {RUN_FILE}",
            hint="give the run folder of a `rema evaluate`",
            path=str(path),
        )
    with storage_errors(path):
        payload = path.read_bytes()
    try:
        header: dict[str, Any] = json.loads(payload.decode("utf-8"))
        every = _FIELDS | _OPTIONAL
        known = (
            header["format"] == RUN_FORMAT
            and _FIELDS.keys() <= header.keys() <= every.keys()
            and all(isinstance(value, every[name]) for name, value in header.items())
            and all(isinstance(segment, dict) for segment in header["segments"])
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        known = False
    if not known:
        raise IntegrityError(
            f"{path} is not a run header of this version",
            hint="restore it from a copy, or evaluate the policy into another folder with --output",
            path=str(path),
        )
    return header, payload


def isolation_level(header: Mapping[str, Any]) -> str | None:
    """The lowest level of isolation among the processes that asked the policy; None where one of them noted none."""
    noted = [segment["isolation"] for segment in header["segments"] if "isolation" in segment]
    levels = [one.get("level") if isinstance(one, dict) else None for one in noted]
    return min((str(level) for level in levels), default=None) if all(levels) else None


def resume_command(header: dict[str, Any], folder: Path) -> str:
    """The ``rema evaluate`` that made a run, as far as ``run.json`` tells: without its checkpoint."""
    policy, identity = header["policy"], header["identity"]
    name = policy.get("name")
    if name not in policy_names():
        name = f"{policy['file']}:{policy['class_name']}" if {"file", "class_name"} <= policy.keys() else "POLICY"
    words = ["rema", "evaluate", str(name)]
    for option in ("task", "protocol", "split"):
        if option in identity:
            words += [f"--{option}", str(identity[option])]
    devices = [segment["device"] for segment in header["segments"] if isinstance(segment.get("device"), str)]
    if devices:
        words += ["--device", devices[-1]]
    for option in ("shard", "batch_size"):
        noted = {str(segment[option]) for segment in header["segments"] if segment.get(option) is not None}
        if len(noted) == 1:  # a merged run has several shards, and goes on as a whole
            words += [f"--{option.replace('_', '-')}", *noted]
    words += ["--episodes", str(header["episodes"]), "--output", str(folder)]
    return shlex.join(words)
