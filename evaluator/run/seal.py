"""The seal of a run: one sha256 in ``run.json``, over its results table, its action log and the rest of ``run.json``.

A seal shows that nothing changed since it was made, not who made it: who can write in the folder can seal it again.
Only simulating the recorded actions again shows that a run is true. ``summary.json`` follows from what is sealed, so
every reader compares it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = [
    "ACTIONS_FILE",
    "OLD_RESULTS_FILE",
    "RESULTS_FILE",
    "SUMMARY_FILE",
    "canonical",
    "old_seal_problems",
    "results_name",
    "seal_of",
    "sealed_names",
]

RESULTS_FILE = "results.parquet"
OLD_RESULTS_FILE = "episodes.parquet"
"""Name of the same table in runs of format 1."""
ACTIONS_FILE = "actions.bin"
SUMMARY_FILE = "summary.json"


def canonical(value: Any) -> bytes:
    """JSON with sorted names and no spaces, ASCII: the same for the same content."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode("ascii")


def results_name(header: Mapping[str, Any]) -> str:
    """Name of the results table of a run; ``header`` is the content of its ``run.json``."""
    return OLD_RESULTS_FILE if header["format"] == 1 else RESULTS_FILE


def sealed_names(header: Mapping[str, Any]) -> tuple[str, str]:
    """Names of the files that a seal is over, besides ``run.json``."""
    return results_name(header), ACTIONS_FILE


def seal_of(header: Mapping[str, Any], files: Mapping[str, bytes]) -> str:
    """The seal of a run: sha256, hexadecimal.

    ``header`` is the content of ``run.json``, in which a seal is left out; ``files`` has results and action log.
    """
    total = hashlib.sha256(canonical(_unsealed(header)))
    for name in sealed_names(header):
        total.update(hashlib.sha256(files[name]).digest())
    return total.hexdigest()


def old_seal_problems(header: Mapping[str, Any], files: Mapping[str, bytes | None]) -> Iterator[tuple[str, str]]:
    """Files, or parts of ``run.json`` (with an empty file name), that are not as a seal of format 1 or 2 has them."""
    seal: Mapping[str, Any] = header["seal"]
    body = {name: value for name, value in seal.items() if name != "sha256"}
    if seal["sha256"] != _digest(body):
        yield "", "seal"
        return
    here = {name: _digest(value) for name, value in _unsealed(header).items()}
    yield from (("", name) for name in sorted(here | seal["parts"]) if here.get(name) != seal["parts"].get(name))
    for name, content in files.items():
        if content is not None and hashlib.sha256(content).hexdigest() != seal["files"].get(name):
            yield name, ""


def _unsealed(header: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in header.items() if name != "seal"}


def _digest(value: Any) -> str:
    return hashlib.sha256(canonical(value)).hexdigest()
