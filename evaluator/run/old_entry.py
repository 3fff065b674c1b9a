"""Entries of format 1: counts and one bit a scenario, without the actions that gave them.

Nobody can derive their numbers again, so the board shows them as not verified.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from evaluator.protocol import acting_steps
from evaluator.run.audit import Audit
from evaluator.run.counts import Counts
from evaluator.run.derived import Outcomes
from evaluator.run.entry_fields import Link, Marks, Name
from evaluator.run.header import Protocol, Sha256, Task
from evaluator.run.run import Provenance, Run
from rema_data.errors import IntegrityError
from rema_data.schema import Failure
from rema_data.validation import record, validated

__all__ = ["read_old_entry"]


@record
class _Policy:
    name: Name
    privileged: bool
    link: Link


@record
class _Evidence:
    merkle_root: Sha256
    seal: Sha256


@record
class _Outcomes:
    eligible: str
    success: str


@record
class _Entry:
    format: Literal[1]
    policy: _Policy
    task: Task
    split: Literal["test", "val"]
    protocol: Protocol
    counts: Counts
    marks: Marks
    provenance: dict[str, str | int | bool | None]
    audit: Audit
    evidence: _Evidence
    outcomes: _Outcomes
    sha256: str


def read_old_entry(content: Any, path: Path, refused: str, hint: str) -> Run:
    """A run from the content of an entry of format 1, whose seal was checked; a ValueError where its counts differ."""
    entry = validated(_Entry, content, refused, hint=hint, error=IntegrityError)
    marks = entry.marks
    return Run(
        source=path,
        policy=entry.policy.name,
        privileged=entry.policy.privileged,
        task=entry.task,
        split=entry.split,
        protocol=entry.protocol,
        provenance=Provenance(
            policy_digest=marks.policy_digest,
            protocol_hash=marks.protocol_hash,
            scenarios_hash=marks.scenarios_hash,
            fingerprint=marks.fingerprint,
            environment=entry.provenance,
            seal=entry.evidence.seal,
        ),
        audit=entry.audit,
        isolation=str(entry.provenance.get("isolation") or ""),
        link=entry.policy.link,
        digest=entry.sha256,
        packed=(entry.counts, _outcomes(entry)),
    )


def _outcomes(entry: _Entry) -> Outcomes:
    counts = entry.counts
    unknown = sorted(entry.counts.failures.keys() - {label.value for label in Failure})
    if unknown:
        raise ValueError(f"unknown failure labels {', '.join(unknown)}")
    if not counts.add_up(acting_steps(entry.task, entry.protocol)):
        raise ValueError("its counts do not add up")
    eligible, success = (
        _unpack(packed, counts.episodes) for packed in (entry.outcomes.eligible, entry.outcomes.success)
    )
    found = int(eligible.sum()), int((success & eligible).sum()), int(success.sum())
    if found != (counts.eligible, counts.successes, counts.successes):
        raise ValueError(
            f"its outcomes hold {found[1]} successes of {found[0]} episodes, its counts say {counts.successes} of "
            f"{counts.eligible}"
        )
    return Outcomes(eligible, success)


def _unpack(text: str, count: int) -> npt.NDArray[np.bool_]:
    """One bit a scenario, the first one in the highest bit."""
    data = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    if data.size != -(-count // 8):
        raise ValueError(f"{data.size} bytes of outcomes for {count} episodes")
    bits = np.unpackbits(data).astype(bool)
    if bits[count:].any():
        raise ValueError("outcomes behind the last episode")
    return bits[:count]
