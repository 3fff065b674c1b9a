"""The same policies over fresh scenarios: a rate that holds on frozen lists alone was not learned."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from scipy.stats import fisher_exact

from evaluator.leaderboard.ranking import LEVEL
from evaluator.run.run import Run
from evaluator.scenarios import installed_list
from evaluator.scenarios.seeds import seed_of
from evaluator.statistics import difference_interval, holm

__all__ = ["FreshGap", "fresh_counts", "fresh_gaps", "fresh_remarks"]

Key = tuple[str, tuple[str, str, str]]
"""Protocol, and what is equal in runs of one policy."""
Counts = tuple[int, int]
"""Successes, and episodes."""


class FreshGap(NamedTuple):
    """Clean rate of a policy minus that over fresh scenarios, with the 95 % interval."""

    gap: float
    low: float
    high: float
    falls: bool  # whether the fresh rate is significantly lower (Fisher's exact test, Holm over the board)


def fresh_counts(runs: Sequence[Run]) -> dict[Key, Counts]:
    """Successes and episodes of every policy over fresh lists: whole ones, simulated here, one of a seed.

    The longest of a seed counts: its shorter lists hold the same scenarios.
    """
    longest: dict[tuple[Key, str], Run] = {}
    for run in runs:
        if not run.verified:  # of an entry that was not simulated here, nothing is known
            continue
        listed = installed_list(run.task, run.split, run.version)
        whole = listed is not None and run.counts.episodes == listed[1] and not run.unfinished
        if whole and not run.stopped_early and run.provenance.policy_digest:
            seed = seed_of(run.version)
            known = longest.setdefault(((run.protocol, run.same_policy), seed), run)
            if run.counts.episodes > known.counts.episodes:
                longest[(run.protocol, run.same_policy), seed] = run
    found: dict[Key, Counts] = {}
    for (key, _), run in longest.items():
        successes, episodes = found.get(key, (0, 0))
        found[key] = successes + run.counts.successes, episodes + run.counts.eligible
    return {key: counts for key, counts in found.items() if counts[1]}


def fresh_gaps(runs: Sequence[Run], fresh: Mapping[Key, Counts]) -> list[FreshGap | None]:
    """How far every run is above its policy over fresh scenarios; None where it was not played, or has no result."""
    tables: list[tuple[int, int, int, int] | None] = []
    for run in runs:
        found = fresh.get((run.protocol, run.same_policy))
        known = found is not None and run.has_counts and run.counts.eligible
        tables.append((run.counts.successes, run.counts.eligible, *found) if found and known else None)
    adjusted = iter(holm([_p(*table) for table in tables if table is not None]))
    return [None if table is None else _gap(table, next(adjusted)) for table in tables]


def fresh_remarks(runs: Sequence[Run], shown: set[Key]) -> Iterator[str]:
    """Why runs over fresh scenarios are beside no row; ``shown`` are the rows over the frozen lists."""
    for run in runs:
        if (run.protocol, run.same_policy) not in shown:
            yield (
                f"{run.policy} ({run.task}, {run.protocol}, {run.version}) is not shown: fresh scenarios are compared "
                "with the frozen list, over which its policy was not played."
            )


def _gap(table: tuple[int, int, int, int], p: float) -> FreshGap:
    gap = table[0] / table[1] - table[2] / table[3]
    return FreshGap(gap, *difference_interval(*table), gap > 0 and p <= LEVEL)


def _p(clean: int, of_clean: int, fresh: int, of_fresh: int) -> float:
    return float(fisher_exact([[clean, of_clean - clean], [fresh, of_fresh - fresh]]).pvalue)
