"""A finished run as it lies in its folder: read whole, and refused where its files do not agree with each other."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from evaluator.run.header import read_header
from evaluator.run.records import ANSWERS, read_journal
from evaluator.run.scored import acting_steps, read_run
from evaluator.run.tables import episodes_schema
from rema_data.errors import IntegrityError, MissingFileError

__all__ = ["FinishedRun", "read_finished"]

_AGAIN = "run the same `rema evaluate` again: it writes the tables anew from its records"
_TIMINGS = ("step", "seconds", "worker", "attempt")
_SUMMARY: dict[str, type | UnionType] = {
    "split": str,
    "episodes": int,
    "success_rate": float | None,
    "ci95": list | None,
    "success_rate_bounds": list | None,
    "policy_error_reasons": dict,
    "nondeterministic": int,
    "funnel": list,
    "seconds": dict,
    "episodes_per_second": float | None,
    "segments": int,
    "policy_digest": str,
    "protocol_hash": str,
    "scenarios_hash": str,
    "fingerprint": dict,
}
"""What the page needs of ``summary.json`` besides what ``read_run`` checks."""

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A run.

    Attributes
    ----------
    path : Path
    tag : str
        Kind of contestant, as in the leaderboard.
    header, summary : mapping
        Content of ``run.json`` and of ``summary.json``.
    episodes, timings : sequence of mapping
        Rows of ``episodes.parquet`` and of ``timings.parquet``; a null is None.
    steps : tuple of int
        Steps in which the policy acted, ascending.
    digest : str
        sha256 of ``episodes.parquet``, hexadecimal.
    """

    path: Path
    tag: str
    header: Mapping[str, Any]
    summary: Mapping[str, Any]
    episodes: Sequence[Row]
    timings: Sequence[Row]
    steps: tuple[int, ...]
    digest: str

    @property
    def task(self) -> str:
        """Name of the task."""
        return str(self.summary["task"])

    @property
    def end_to_end(self) -> bool:
        """Whether the policy did every step."""
        return bool(self.summary["protocol"] == "end-to-end")

    @property
    def measured(self) -> list[Row]:
        """The eligible episodes: those with an outcome."""
        return [row for row in self.episodes if row["success"] is not None]

    def faults(self) -> list[Mapping[str, Any]]:
        """What the policy said where it gave no action: ``index``, ``step``, ``reason`` and ``detail``.

        Raises
        ------
        IntegrityError
            A line of the records is damaged.
        """
        if not self.summary["policy_errors"]:
            return []
        answers = (row for _, row in read_journal(self.path / "records", ANSWERS))
        return [row for row in answers if row["action"] is None and row["index"] < len(self.episodes)]


def read_finished(path: Path) -> FinishedRun:
    """Read a run folder.

    Parameters
    ----------
    path : Path

    Raises
    ------
    MissingFileError
        There is no such run, or it did not finish.
    InputError, IntegrityError
        A file cannot be read, or the tables do not give the numbers of the summary.
    """
    known = read_run(path)
    summary = _summary(path / "summary.json")
    header, _ = read_header(path)
    if not all(isinstance(part, dict) for part in header["segments"]):
        raise IntegrityError(f"{path / 'run.json'} has a segment that is none", hint=_AGAIN, path=str(path))
    payload = _bytes(path / "episodes.parquet")
    episodes = _table(path / "episodes.parquet", payload, episodes_schema(known.task).names)
    timings = _table(path / "timings.parquet", _bytes(path / "timings.parquet"), _TIMINGS)
    steps = acting_steps(known.task, known.protocol)
    return FinishedRun(path, known.tag, header, summary, episodes, timings, steps, hashlib.sha256(payload).hexdigest())


def _bytes(path: Path) -> bytes:
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint=_AGAIN, path=str(path))
    return path.read_bytes()


def _summary(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(_bytes(path))
        wrong = [name for name, kind in _SUMMARY.items() if name not in content or not isinstance(content[name], kind)]
        if not isinstance(content.get("seconds", {}).get("total"), int | float):
            wrong.append("seconds.total")
    except (ValueError, TypeError, AttributeError) as error:
        raise IntegrityError(f"{path} cannot be read: {error}", hint=_AGAIN, path=str(path)) from error
    if wrong:
        raise IntegrityError(f"{path} does not say {', '.join(wrong)}", hint=_AGAIN, path=str(path), missing=wrong)
    return content


def _table(path: Path, payload: bytes, columns: Sequence[str]) -> list[Row]:
    try:
        table = pq.read_table(io.BytesIO(payload))
    except (pa.ArrowException, OSError) as error:
        raise IntegrityError(f"{path} is not a Parquet table: {error}", hint=_AGAIN, path=str(path)) from error
    missing = [column for column in columns if column not in table.column_names]
    if missing:
        raise IntegrityError(f"{path} lacks {', '.join(missing)}", hint=_AGAIN, path=str(path), missing=missing)
    rows: list[Row] = table.to_pylist()
    return rows
