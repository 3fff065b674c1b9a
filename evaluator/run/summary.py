"""``summary.json``: the numbers of a run, which follow from ``run.json`` and the results table."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NotRequired

import pyarrow as pa
import pydantic
from pydantic import NonNegativeInt
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from evaluator.run.audit import AuditNumbers
from evaluator.run.counts import Counts, summary_numbers
from evaluator.run.header import isolation_level
from rema_data.errors import InputError
from rema_data.validation import validated

__all__ = ["PHASES", "read_summary", "summarise"]

PHASES = ("observe", "infer", "simulate", "audit", "total")


@pydantic.with_config(pydantic.ConfigDict(extra="allow", strict=True))
class _Summary(TypedDict):
    """Of formats 1 and 2: what neither the rows nor ``run.json`` tell; the rest is compared with them."""

    unfinished: NonNegativeInt
    policy_error_reasons: dict[str, NonNegativeInt]
    nondeterministic: NonNegativeInt
    audit: AuditNumbers | None
    seconds: dict[str, float]
    episodes_per_second: float | None
    segments: NonNegativeInt
    stopped_early: NotRequired[bool | dict[str, Any]]


def summarise(header: Mapping[str, Any], counts: Counts, table: pa.Table, unfinished: int) -> dict[str, Any]:
    """The content of ``summary.json``, from ``run.json`` and the results table: every reader makes it again.

    ``unfinished`` episodes have no result: the run is partial. ``seconds`` and ``episodes_per_second`` are sums over
    the segments that ended in an orderly way; ``engine`` and ``workers`` are those of the last segment, or null.
    """
    seconds, rate = _time(header["segments"])
    identity, end = header["identity"], header["end"]
    last = header["segments"][-1] if header["segments"] else {}
    content = {
        "task": identity["task"],
        "split": identity["split"],
        "policy": header["policy"].get("name"),
        "privileged": header["policy"].get("privileged"),
        "protocol": identity["protocol"],
        **summary_numbers(counts, table),
        "unfinished": unfinished,
        "policy_error_reasons": end["policy_error_reasons"],
        "nondeterministic": end["nondeterministic"],
        "audit": end["audit"],
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
    }
    if end["stopped_early"] is not None:
        content["stopped_early"] = end["stopped_early"]
    return content


def _time(segments: list[dict[str, Any]]) -> tuple[dict[str, float], float | None]:
    """Seconds by phase, and finished episodes a second, over the segments that say how long they took."""
    timed = [segment for segment in segments if "seconds" in segment]
    seconds = {phase: round(sum(segment["seconds"].get(phase, 0.0) for segment in timed), 3) for phase in PHASES}
    finished = sum(segment.get("finished", 0) for segment in timed)
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
