"""The seal of a run: digests in ``run.json`` of everything that a finished run says, ``run.json`` itself included.

A seal shows that nothing changed since it was made, not who made it: who can write in the folder can seal it again. A
signature over ``run.json`` shows who signed it, and a replay whether it is true.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from evaluator.run.rows import canonical

__all__ = [
    "ACTIONS_FILE",
    "LEAVES_FILE",
    "OLD_RESULTS_FILE",
    "RESULTS_FILE",
    "SUMMARY_FILE",
    "changed_parts",
    "make_seal",
    "results_name",
    "seal_is_whole",
    "sealed_files",
]

RESULTS_FILE = "results.parquet"
OLD_RESULTS_FILE = "episodes.parquet"
"""Name of the same table in runs of format 1."""
ACTIONS_FILE = "actions.bin"
LEAVES_FILE = "leaves.bin"
"""Leaf hashes of the rows, 32 bytes each: a changed row is named by them, and one row is proved without the table."""
SUMMARY_FILE = "summary.json"

_VERSION = 1
_FILES = {ACTIONS_FILE, LEAVES_FILE, SUMMARY_FILE}
"""The sealed files besides the results table."""


def results_name(header: Mapping[str, Any]) -> str:
    """Name of the results table of a run; ``header`` is the content of its ``run.json``."""
    return OLD_RESULTS_FILE if header["format"] == 1 else RESULTS_FILE


def sealed_files(header: Mapping[str, Any]) -> set[str]:
    """Names of the files that a seal is over."""
    return {results_name(header), *_FILES}


def make_seal(
    header: dict[str, Any], files: Mapping[str, bytes], *, root: bytes, steps: Sequence[int], unfinished: int
) -> dict[str, Any]:
    """The seal of a run, ready for JSON; a seal that ``header`` has already is left out.

    ``files`` is the content of the four sealed files by name, ``root`` that of the tree over the rows, and ``steps``
    are the columns of ``actions.bin``.
    """
    seal = {
        "version": _VERSION,
        "merkle_root": root.hex(),
        "steps": list(steps),
        "unfinished": unfinished,
        "files": {name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
        "parts": _parts(header),
    }
    return {**seal, "sha256": _digest(seal)}


def changed_parts(header: dict[str, Any]) -> list[str]:
    """Names of the entries of ``run.json`` that are not those that its seal names; none where it has no seal."""
    sealed: dict[str, str] = header.get("seal", {}).get("parts", {})
    here = _parts(header)
    return sorted(name for name in here | sealed if here.get(name) != sealed.get(name)) if sealed else []


def seal_is_whole(header: Mapping[str, Any]) -> bool:
    """Whether the seal in the content of a ``run.json`` has its own digest, and names the files of a run."""
    seal = header["seal"]
    body = {name: value for name, value in seal.items() if name != "sha256"}
    return (
        seal["version"] == _VERSION
        and seal["files"].keys() == sealed_files(header)
        and bool(seal["sha256"] == _digest(body))
    )


def _parts(header: dict[str, Any]) -> dict[str, str]:
    return {name: _digest(value) for name, value in header.items() if name != "seal"}


def _digest(value: Any) -> str:
    return hashlib.sha256(canonical(value)).hexdigest()
