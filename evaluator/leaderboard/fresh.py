"""The same policies over fresh scenarios: a rate that holds on frozen lists alone was not learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from evaluator.run.run import Run
from evaluator.statistics import difference_interval

__all__ = ["fresh_counts", "fresh_gap"]

Key = tuple[str, str, str]
"""Task, protocol, and digest of the policy."""
Counts = tuple[int, int]
"""Successes, and episodes."""


def fresh_counts(runs: Sequence[Run]) -> dict[Key, Counts]:
    """Successes and episodes of every policy over fresh lists that were simulated here, all of its lists together."""
    found: dict[Key, Counts] = {}
    for run in runs:
        if run.verified and run.counts.eligible and run.provenance.policy_digest:
            key = run.task, run.protocol, run.provenance.policy_digest
            successes, episodes = found.get(key, (0, 0))
            found[key] = successes + run.counts.successes, episodes + run.counts.eligible
    return found


def fresh_gap(run: Run, fresh: Mapping[Key, Counts]) -> tuple[float, float, float] | None:
    """Clean rate of a run minus that of its policy over fresh scenarios, with the 95 % interval."""
    found = fresh.get((run.task, run.protocol, run.provenance.policy_digest))
    if found is None or not run.has_counts or not run.counts.eligible:
        return None
    counts = run.counts
    low, high = difference_interval(counts.successes, counts.eligible, *found)
    return counts.successes / counts.eligible - found[0] / found[1], low, high
