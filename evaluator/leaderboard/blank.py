"""The same policies without a part of the maps: what they solve nevertheless, they solve without looking at it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from evaluator.leaderboard.eligibility import obstacles
from evaluator.protocol import BLANKED
from evaluator.run.run import Run

__all__ = ["blank_rates", "blank_remarks"]

Key = tuple[str, str, str]
"""What is equal in runs of one policy."""


def blank_rates(runs: Sequence[Run]) -> dict[Key, dict[str, float]]:
    """Rates of every policy in the self-audits, by protocol: those over the whole list that were simulated here."""
    found: dict[Key, dict[str, float]] = {}
    for run in runs:
        if not obstacles(run) and run.counts.rate is not None:
            found.setdefault(run.same_policy, {}).setdefault(run.protocol, run.counts.rate)
    return found


def blank_remarks(runs: Sequence[Run], shown: set[Key]) -> Iterator[str]:
    """What the self-audits mean, and why one of them is not beside a row; ``shown`` are the conditional rows."""
    if runs:
        yield (
            f"{', '.join(BLANKED)}: the rate of the same policy where it is shown zeros in place of the scene, or of "
            "the hand: what it reaches without looking."
        )
    for run in runs:
        reason = next((one.reason for one in obstacles(run)), "")
        if not reason and run.same_policy not in shown:
            reason = "its policy has no conditional row"
        if reason:
            yield f"{run.policy} ({run.task}, {run.protocol}) is not shown: {reason}."
