"""``summary.json``: the numbers of a run, computed from its rows and its records."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any, NotRequired

import pyarrow as pa
import pydantic
from pydantic import NonNegativeInt
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from evaluator.run.counts import Counts, summary_numbers, unfinished
from evaluator.run.header import isolation_level
from evaluator.run.plan import Plan
from evaluator.run.records import Ledger
from rema_data.errors import InputError
from rema_data.validation import record, validated

__all__ = ["PHASES", "Audit", "read_summary", "summarise"]

PHASES = ("observe", "infer", "simulate", "audit", "total")


@record
class Audit:
    """How much of a run was repeated, and how much of that differed."""

    actions: NonNegativeInt
    action_flips: NonNegativeInt
    outcomes: NonNegativeInt
    outcome_flips: NonNegativeInt

    @pydantic.model_validator(mode="after")
    def _add_up(self) -> Audit:
        if self.action_flips > self.actions or self.outcome_flips > self.outcomes:
            raise ValueError("has more flips than repeats")
        return self


@record
class _AuditNumbers(Audit):
    """As ``audit_summary`` gives it."""

    episodes: NonNegativeInt
    action_flips_ci95: tuple[float, float]
    outcome_flips_ci95: tuple[float, float]
    lost: NonNegativeInt
    flipped: list[dict[str, Any]]


@pydantic.with_config(pydantic.ConfigDict(extra="allow", strict=True))
class _Summary(TypedDict):
    """What neither the rows nor ``run.json`` tell; the rest is compared with them."""

    unfinished: NonNegativeInt
    policy_error_reasons: dict[str, NonNegativeInt]
    nondeterministic: NonNegativeInt
    audit: _AuditNumbers | None
    seconds: dict[str, float]
    episodes_per_second: float | None
    segments: NonNegativeInt
    stopped_early: NotRequired[bool | dict[str, Any]]


def summarise(
    plan: Plan,
    ledger: Ledger,
    counts: Counts,
    table: pa.Table,
    header: dict[str, Any],
    root: bytes,
    audit: dict[str, Any] | None,
) -> dict[str, Any]:
    """The content of ``summary.json``: ``summary_numbers`` of the table, and what the rows do not tell.

    ``unfinished`` episodes have no result: the run is partial. ``seconds`` and ``episodes_per_second`` are sums over
    the segments that ended in an orderly way; ``engine`` and ``workers`` are those of the last segment, or null.
    ``root`` is that of the hash tree over the rows.
    """
    seconds, rate = _time(header["segments"])
    faults = Counter(str(answer.reason) for answer in ledger.answers.values() if answer.action is None)
    identity = header["identity"]
    last = header["segments"][-1] if header["segments"] else {}
    return {
        "task": identity["task"],
        "split": identity["split"],
        "policy": header["policy"]["name"],
        "privileged": header["policy"].get("privileged"),
        "protocol": identity["protocol"],
        **summary_numbers(counts, table),
        "unfinished": unfinished(plan, table),
        "policy_error_reasons": dict(sorted(faults.items())),
        "nondeterministic": len(ledger.contradictions),
        "audit": audit,
        "isolation": isolation_level(header),
        "seconds": seconds,
        "episodes_per_second": rate,
        "engine": last.get("engine"),
        "workers": last.get("workers"),
        "segments": len(header["segments"]),
        "policy_digest": identity["policy_digest"],
        "protocol_hash": identity["protocol_hash"],
        "scenarios_hash": identity["scenarios_hash"],
        "fingerprint": identity["fingerprint"],
        "merkle_root": root.hex(),
    }


def _time(segments: list[dict[str, Any]]) -> tuple[dict[str, float], float | None]:
    """Seconds by phase, and finished episodes a second, over the segments that say how long they took."""
    timed = [segment for segment in segments if "seconds" in segment]
    seconds = {phase: round(sum(segment["seconds"].get(phase, 0.0) for segment in timed), 3) for phase in PHASES}
    finished = sum(segment["finished"] for segment in timed)
    return seconds, round(finished / seconds["total"], 3) if seconds["total"] else None


def read_summary(payload: bytes, path: Path) -> dict[str, Any]:
    """The content of a ``summary.json``; an InputError names the fields where it is not the summary of a run."""
    hint = "evaluate the policy again: the same command writes it from the records"
    try:
        content: dict[str, Any] = json.loads(payload.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not the summary of a run: {error}", hint=hint, path=str(path)) from error
    validated(_Summary, content, f"{path} is not the summary of a run", hint=hint)
    return content
