"""What recorded actions give when they are simulated: the result of every step, and all counts that follow.

An entry of the leaderboard holds no result, so its reader derives these. They are kept in two places, each by the
sha256 of what they were derived from: the cache of this machine (``REMA_HOME/verified``), and the verification records
that come with rema (``manifests/leaderboard/verified``).
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from evaluator.run.actions import Actions, encode_actions
from evaluator.run.counts import Counts, FunnelStep
from evaluator.run.header import Sha256
from evaluator.run.seal import canonical
from rema_data.errors import IntegrityError, StorageError
from rema_data.schema import Failure
from rema_data.storage import rema_home, write_atomic
from rema_data.validation import plain, record, validated

__all__ = ["Derived", "Outcomes", "PackedRows", "derived_of", "inflate", "recall", "remember"]

_SUCCESS = "success"
_LABELS = ("", _SUCCESS)
"""The first two labels: the step was not reached, and it succeeded. Failure labels follow, sorted."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """Scenario by scenario, in the order of the list."""

    eligible: npt.NDArray[np.bool_]  # (N,), measured
    success: npt.NDArray[np.bool_]  # (N,), False where it was not measured


@record
class PackedRows:
    """``Derived`` as JSON: ``codes`` are the bytes of the array, deflated, base64."""

    labels: tuple[Annotated[str, Field(max_length=80)], ...]
    codes: str
    sha256: Sha256


@dataclass(frozen=True, slots=True, eq=False)
class Derived:
    """The result of every step of every episode; see ``evaluator.run.derived``."""

    steps: tuple[int, ...]  # in which the policy acts
    labels: tuple[str, ...]  # what a code means
    codes: npt.NDArray[np.uint8]  # (episodes, steps), positions in ``labels``
    fingerprint: Mapping[str, str]  # of the simulator

    @property
    def sha256(self) -> str:
        """sha256 of the rows, hexadecimal."""
        head = canonical([list(self.labels), list(self.codes.shape)])
        return hashlib.sha256(head + self.codes.tobytes()).hexdigest()

    @property
    def outcomes(self) -> Outcomes:
        """Which scenario could be played, and was solved."""
        return Outcomes(self.codes[:, 0] != 0, self.codes[:, -1] == 1)

    @property
    def counts(self) -> Counts:
        """All counts."""
        ends = Counter(self.label(row) for row in range(len(self.codes)))
        failures = {label: count for label, count in sorted(ends.items()) if label not in _LABELS}
        return Counts(
            episodes=len(self.codes),
            eligible=len(self.codes) - ends[""],
            successes=ends[_SUCCESS],
            failures=failures,
            policy_errors=failures.get(Failure.POLICY_ERROR.value, 0),
            infra_errors=0,
            funnel=tuple(
                FunnelStep(step, int((column != 0).sum()), int((column == 1).sum()))
                for step, column in zip(self.steps, self.codes.T, strict=True)
            ),
        )

    def label(self, row: int) -> str:
        """How an episode ended: ``success``, a failure label, or nothing where it could not be played."""
        reached = self.codes[row][self.codes[row] != 0]
        return self.labels[int(reached[-1])] if len(reached) else ""

    def path(self, row: int) -> tuple[str, ...]:
        """The labels of an episode, step by step."""
        return tuple(self.labels[code] for code in self.codes[row].tolist())

    def pack(self) -> dict[str, Any]:
        """``PackedRows``, ready for JSON."""
        codes = base64.b64encode(zlib.compress(self.codes.tobytes(), 9)).decode()
        return dict(plain(PackedRows(self.labels, codes, self.sha256)))

    @classmethod
    def unpack(cls, rows: PackedRows, episodes: int, steps: Sequence[int], fingerprint: Mapping[str, str]) -> Derived:
        """Inverse of ``pack``; a ValueError where it is not that of so many episodes, or not what its hash says."""
        data = inflate(rows.codes, episodes * len(steps))
        codes = np.frombuffer(data, np.uint8).reshape(episodes, len(steps))
        known = {*_LABELS, *(label.value for label in Failure)}
        if rows.labels[:2] != _LABELS or not known.issuperset(rows.labels) or codes.max(initial=0) >= len(rows.labels):
            raise ValueError("its rows have unknown labels")
        found = cls(tuple(steps), rows.labels, codes, dict(fingerprint))
        if found.sha256 != rows.sha256:
            raise ValueError(f"its rows have sha256 {found.sha256}, it says {rows.sha256}")
        return found


def inflate(text: str, size: int) -> bytes:
    """Exactly ``size`` bytes from base64 of a deflated stream; a ValueError otherwise, and never more memory."""
    worker = zlib.decompressobj()
    try:
        data = worker.decompress(base64.b64decode(text, validate=True), size + 1)
    except zlib.error as error:
        raise ValueError(f"it cannot be decompressed: {error}") from error
    if len(data) != size or not worker.eof or worker.unused_data:
        raise ValueError(f"it does not hold the {size:,} bytes that it should")
    return data


def derived_of(table: pa.Table, steps: Sequence[int], fingerprint: Mapping[str, str]) -> Derived:
    """The results in a table of episodes."""
    columns = []
    for step in steps:
        success, failure = (table.column(f"step{step}_{name}").to_pylist() for name in ("success", "failure"))
        columns.append(
            [
                "" if passed is None else _SUCCESS if passed else str(label)
                for passed, label in zip(success, failure, strict=True)
            ]
        )
    labels = (*_LABELS, *sorted({label for column in columns for label in column} - {*_LABELS}))
    number = {label: code for code, label in enumerate(labels)}
    codes = np.array([[number[label] for label in column] for column in columns], np.uint8).T
    return Derived(tuple(steps), labels, np.ascontiguousarray(codes), dict(fingerprint))


@record
class _Remembered:
    fingerprint: dict[str, str]
    rows: PackedRows


def _cached(world: str, rules: Mapping[str, str], actions: Actions) -> Path:
    """Where the rows of these actions are kept; ``world`` is the identity of the simulator's code."""
    log = hashlib.sha256(encode_actions(actions)).hexdigest()
    key = hashlib.sha256(canonical([world, dict(rules), list(actions.shape), log])).hexdigest()
    return rema_home() / "verified" / f"{key}.json"


def remember(world: str, rules: Mapping[str, str], actions: Actions, derived: Derived) -> None:
    """Keep what was simulated here; a full or read-only disk only means that it is simulated again."""
    content = {"fingerprint": dict(derived.fingerprint), "rows": derived.pack()}
    try:
        write_atomic(_cached(world, rules, actions), json.dumps(content) + "\n")
    except StorageError:
        return


def recall(world: str, rules: Mapping[str, str], actions: Actions, steps: Sequence[int]) -> Derived | None:
    """What these actions gave when they were simulated here, by the same code; None where they were not."""
    path = _cached(world, rules, actions)
    try:
        kept = validated(_Remembered, json.loads(path.read_bytes()), str(path), error=IntegrityError)
        return Derived.unpack(kept.rows, len(actions), steps, kept.fingerprint)
    except (OSError, ValueError, IntegrityError):
        return None
