"""The records of a run on disk while it runs: append-only JSON lines, one segment file for each writing process.

``answers-0001.jsonl`` holds what the policy answered, ``outcomes-0001.jsonl`` which action the simulator carried out
and what came of it: an outcome counts only beside the answer that it belongs to. A process
that was killed leaves at most one torn line at the end of its segments; the next process starts segments of its own.
A line is ``[checksum,{...}]``: a digit that changed on the disk must not become a result.
"""

from __future__ import annotations

import json
import os
import time
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NotRequired

import pydantic
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from evaluator.engines.base import InfraError
from rema_data import grid
from rema_data.errors import IntegrityError
from rema_data.json_files import parse_json
from rema_data.schema import Failure, StepOutcome, outcome_from_dict, to_dict
from rema_data.storage import storage_errors, sync_folder

__all__ = ["Answered", "Journal", "Ledger", "Records", "Simulated", "read_journal", "same_outcome"]

ANSWERS = "answers"
OUTCOMES = "outcomes"
POLICY_FAULT = StepOutcome(False, Failure.POLICY_ERROR)
"""The outcome of a step for which the policy gave no action."""


@dataclass(frozen=True, slots=True)
class Answered:
    """What the policy said about one step of one episode: a grid index, or the reason and detail of a fault."""

    index: int
    step: int
    action: int | None
    reason: str | None = None
    detail: str | None = None
    segment: int = 0


@dataclass(frozen=True, slots=True)
class Simulated:
    """What came of one action: an outcome, or the infrastructure error that stands in for it."""

    index: int
    step: int
    outcome: StepOutcome | InfraError
    seconds: float
    worker: str
    attempt: int
    segment: int = 0


class Journal:
    """An append-only file of JSON lines, created at the first line, for the process number ``segment``.

    Lines reach the operating system at once, and the disk at most ``sync_s`` seconds later (and on ``close``).
    """

    def __init__(self, folder: Path, name: str, segment: int, sync_s: float = 1.0) -> None:
        self.path = folder / f"{name}-{segment:04d}.jsonl"
        self._sync_s = sync_s
        self._descriptor: int | None = None
        self._synced = time.monotonic()
        self._waiting = False  # are there lines that may not have reached the disk?

    def append(self, rows: Iterable[dict[str, Any]]) -> None:
        """Write rows. Where the disk is full (StorageError), rows written before stay readable."""
        payload = b"".join(map(_line, rows))
        if not payload:
            return
        with storage_errors(self.path):
            if self._descriptor is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o644)
                sync_folder(self.path.parent)
            while payload:
                payload = payload[os.write(self._descriptor, payload) :]
            self._waiting = True
        if time.monotonic() - self._synced >= self._sync_s:
            self.sync()

    def sync(self) -> None:
        """Wait until every line is on the disk."""
        if self._descriptor is not None and self._waiting:
            with storage_errors(self.path):
                os.fsync(self._descriptor)
            self._waiting = False
        self._synced = time.monotonic()

    def close(self) -> None:
        """Sync and close."""
        if self._descriptor is not None:
            descriptor = self._descriptor
            try:
                self.sync()
            finally:
                self._descriptor = None
                os.close(descriptor)


def _plain(value: Any) -> Any:
    """Numbers of numpy as Python's own."""
    return value.item()


def _line(row: dict[str, Any]) -> bytes:
    content = json.dumps(row, separators=(",", ":"), default=_plain).encode()
    return b"[%d,%b]\n" % (zlib.crc32(content), content)


def _content(line: bytes) -> bytes:
    """JSON of a line, or a ValueError where its checksum is another one."""
    checksum, _, content = line[1:-1].partition(b",")
    if b"[%d,%b]" % (zlib.crc32(content), content) != line:
        raise ValueError(f"the checksum is not {checksum!r}")
    return content


@pydantic.with_config(pydantic.ConfigDict(extra="forbid", strict=True))
class _AnswerRow(TypedDict):
    index: pydantic.NonNegativeInt
    step: pydantic.NonNegativeInt
    action: Annotated[int, pydantic.Field(ge=0, lt=grid.ACTIONS)] | None
    reason: NotRequired[str | None]
    detail: NotRequired[str | None]


@pydantic.with_config(pydantic.ConfigDict(extra="forbid", strict=True))
class _OutcomeRow(TypedDict):
    index: pydantic.NonNegativeInt
    step: pydantic.NonNegativeInt
    action: NotRequired[Annotated[int, pydantic.Field(ge=0, lt=grid.ACTIONS)] | None]
    outcome: StepOutcome | None
    error: InfraError | None
    seconds: float
    worker: str
    attempt: int


_SHAPES: dict[str, Any] = {ANSWERS: _AnswerRow, OUTCOMES: _OutcomeRow}


@cache
def _adapter(shape: Any) -> pydantic.TypeAdapter[Any]:
    return pydantic.TypeAdapter(shape)


def read_journal(folder: Path, name: str, shape: Any = None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Segment number and content of every whole line, in the order of writing.

    ``shape`` is what pydantic checks a line against; answers and outcomes have theirs. A damaged line, other than a
    torn last one, is an IntegrityError, and so is one with a valid checksum around something else.
    """
    adapter = _adapter(_SHAPES[name] if shape is None else shape)
    for path in sorted(folder.glob(f"{name}-*.jsonl")):
        digits = path.stem.removeprefix(f"{name}-")
        if not digits.isdecimal():
            continue  # somebody's copy
        segment = int(digits)
        *lines, torn = path.read_bytes().split(b"\n")
        for number, line in enumerate(lines, 1):
            try:
                content = _content(line)
            except ValueError as error:
                if number == len(lines) and not torn:
                    break  # a power cut may leave rubbish instead of a torn line
                raise IntegrityError(
                    f"{path}, line {number} is damaged",
                    hint=f"delete the line (its episode is redone) or the run folder {folder.parent}",
                    path=str(path),
                    line=number,
                ) from error
            try:
                adapter.validate_json(content)
                row: dict[str, Any] = parse_json(content)
                _check_names(row)
            except (ValueError, TypeError) as error:
                raise IntegrityError(
                    f"{path}, line {number} is whole, and holds something else than the {name} of a run",
                    hint=f"delete the folder {folder.parent}, and run the same command again",
                    path=str(path),
                    line=number,
                ) from error
            yield segment, row


def _check_names(row: dict[str, Any]) -> None:
    """Raise where an outcome has fields that are not known: pydantic looks over those of plain dataclasses."""
    if row.get("outcome") is not None:
        outcome_from_dict(row["outcome"])
    if row.get("error") is not None:
        InfraError(**row["error"])


class Records:
    """Answers and outcomes of a run, in memory.

    Attributes
    ----------
    answers : dict of (index, step) to Answered
    faults : list of Answered
        Those of the answers that are no action.
    outcomes : dict of (index, step) to Simulated
    contradictions : list of (index, step)
        Steps that were simulated twice with different outcomes: the world was not deterministic.
    segment : int
        Number under which this process records.
    """

    def __init__(self) -> None:
        self.answers: dict[tuple[int, int], Answered] = {}
        self.faults: list[Answered] = []
        self.outcomes: dict[tuple[int, int], Simulated] = {}
        self.contradictions: list[tuple[int, int]] = []
        self.segment = 0

    def _keep_answer(self, record: Answered) -> bool:
        first = self.answers.setdefault((record.index, record.step), record)
        if first is record and record.action is None:
            self.faults.append(record)
        return first is record

    def _keep_outcome(self, record: Simulated) -> None:
        """Keep the first outcome, compare any second one, and let an outcome replace an infrastructure error."""
        key = (record.index, record.step)
        first = self.outcomes.get(key)
        if first is None or isinstance(first.outcome, InfraError):
            self.outcomes[key] = record
        elif isinstance(record.outcome, StepOutcome) and not same_outcome(record.outcome, first.outcome):
            self.contradictions.append(key)

    def add_answers(self, records: Iterable[Answered]) -> None:
        """Record answers; a step keeps its first one."""
        for record in records:
            self._keep_answer(record)

    def add_outcomes(self, records: Iterable[Simulated]) -> None:
        """Record outcomes."""
        for record in records:
            self._keep_outcome(record)

    def result(self, index: int, step: int) -> StepOutcome | InfraError | None:
        """What came of a step: an outcome (of the simulator, or that of a policy's fault), an error, or nothing yet."""
        answer = self.answers.get((index, step))
        if answer is not None and answer.action is None:
            return POLICY_FAULT
        record = self.outcomes.get((index, step))
        return None if record is None else record.outcome


class Ledger(Records):
    """Everything recorded in ``RUN/records``, in memory, with the journals that this process, ``segment``, writes."""

    def __init__(self, folder: Path, segment: int) -> None:
        super().__init__()
        self.segment = segment
        for number, row in read_journal(folder, ANSWERS):
            self._keep_answer(Answered(**row, segment=number))
        for number, row in read_journal(folder, OUTCOMES):
            fields = dict(row)
            error, outcome, action = fields.pop("error"), fields.pop("outcome"), fields.pop("action", None)
            answer = self.answers.get((row["index"], row["step"]))
            if action is not None and (answer is None or answer.action != action):
                continue  # of an answer whose line was lost: the policy was, or will be, asked again
            record = outcome_from_dict(outcome) if error is None else InfraError(**error)
            self._keep_outcome(Simulated(**fields, outcome=record, segment=number))
        self._answers = Journal(folder, ANSWERS, segment)
        self._outcomes = Journal(folder, OUTCOMES, segment)

    def add_answers(self, records: Iterable[Answered]) -> None:
        """Record answers; a step keeps its first one."""
        new = [record for record in records if self._keep_answer(record)]
        self._answers.append({name: getattr(record, name) for name in _AnswerRow.__annotations__} for record in new)

    def add_outcomes(self, records: Iterable[Simulated]) -> None:
        """Record outcomes, once the answers before them are on the disk."""
        self._answers.sync()
        rows = []
        for record in records:
            self._keep_outcome(record)
            failed = isinstance(record.outcome, InfraError)
            content = to_dict(record.outcome)
            rows.append(
                {
                    "index": record.index,
                    "step": record.step,
                    "action": self._action(record),
                    "outcome": None if failed else content,
                    "error": content if failed else None,
                    "seconds": round(record.seconds, 6),
                    "worker": record.worker,
                    "attempt": record.attempt,
                }
            )
        self._outcomes.append(rows)

    def _action(self, record: Simulated) -> int | None:
        answer = self.answers.get((record.index, record.step))
        return None if answer is None else answer.action

    def close(self) -> None:
        """Sync and close the journals."""
        try:
            self._answers.close()
        finally:
            self._outcomes.close()


def same_outcome(one: StepOutcome | InfraError, other: StepOutcome | InfraError) -> bool:
    """Whether two outcomes agree in every field, to the last bit of every number."""
    return _text(one) == _text(other)


def _text(outcome: StepOutcome | InfraError) -> str:
    return json.dumps(to_dict(outcome), default=_plain)
