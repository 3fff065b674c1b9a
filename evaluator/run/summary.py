"""``summary.json``: the numbers of a run, computed from its rows and its records."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pyarrow as pa

from evaluator.run.counts import tally, unfinished
from evaluator.run.header import isolation_level
from evaluator.run.plan import Plan
from evaluator.run.records import Ledger

__all__ = ["PHASES", "summarise"]

PHASES = ("observe", "infer", "simulate", "audit", "total")


def summarise(
    plan: Plan,
    ledger: Ledger,
    table: pa.Table,
    header: dict[str, Any],
    root: bytes,
    audit: dict[str, Any] | None,
) -> dict[str, Any]:
    """The content of ``summary.json``.

    Parameters
    ----------
    plan : Plan
    ledger : Ledger
    table : pyarrow.Table
        Rows of ``episodes.parquet``.
    header : dict
        Content of ``run.json``.
    root : bytes
        Of the hash tree over the rows.
    audit : dict or None
        From ``evaluator.runner.audit``; None where nothing was repeated.

    Returns
    -------
    dict
        What ``tally`` counts, and what the rows do not tell. ``unfinished`` episodes have no result: the run is
        partial. ``seconds`` and ``episodes_per_second`` are sums over the segments that ended in an orderly way;
        ``engine`` and ``workers`` are those of the last segment, null where nothing was recorded.
    """
    numbers = tally(table, plan.steps)
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
        **numbers,
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
