"""Ranks: every pair of ranked runs is tested on the same scenarios, adjusted for the number of pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from evaluator.leaderboard.copies import near_copies
from evaluator.leaderboard.eligibility import obstacles
from evaluator.run.derived import Outcomes
from evaluator.run.run import Run
from evaluator.statistics import PairTable, holm, midp_mcnemar, pair_table, tie_letters

__all__ = ["LEVEL", "Pair", "Standing", "rank_runs"]

LEVEL = 0.05
"""Pairs whose adjusted p value is above this share a letter."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Place of a run among the others of its task and protocol."""

    # 1 plus the policies with a rank that are significantly better; None: privileged, a simulator, or unranked
    rank: int | None = None
    ties: str = ""  # letters shared with the runs from which it does not differ significantly
    unranked: str = ""  # why it has no rank; empty if it has, or its kind has none


@dataclass(frozen=True, slots=True)
class Pair:
    """The test of two runs, by their positions; ``p`` is adjusted for the whole family (Holm)."""

    first: int
    second: int
    table: PairTable
    p: float

    @property
    def better(self) -> int | None:
        """The run that is significantly better, if one is."""
        if self.p > LEVEL or self.table.only_a == self.table.only_b:
            return None
        return self.first if self.table.only_a > self.table.only_b else self.second


def rank_runs(runs: Sequence[Run]) -> tuple[list[Standing], list[Pair]]:
    """Standings of ``runs``, in their order, and the pairs that were tested.

    The family of the adjustment is every pair of ranked runs of one task and protocol, over all tasks and protocols
    given. A run with almost the actions of an earlier one (``runs`` are in that order) has no rank and is in no pair.
    One that lost episodes to the infrastructure is tested with all of them failed and with all of them solved as well:
    where that changes who is better, it has no rank.
    """
    reasons = [next((obstacle.reason for obstacle in obstacles(run)), "") for run in runs]
    for n, original in near_copies(runs, [n for n, reason in enumerate(reasons) if not reason]).items():
        reasons[n] = f"almost all of its actions are those of {runs[original].policy}"
    outcomes = {n: run.outcomes for n, run in enumerate(runs) if not reasons[n]}
    for n in _undecided(runs, outcomes):
        reasons[n] = "its rank depends on episodes lost to the infrastructure"
        del outcomes[n]
    pairs = _test(runs, outcomes)
    letters = _letters(runs, list(outcomes), pairs)
    standings = []
    for n, run in enumerate(runs):
        ranked = n in outcomes and run.honest
        standings.append(Standing(1 + _beaten_by(n, runs, pairs) if ranked else None, letters.get(n, ""), reasons[n]))
    return standings, pairs


def _undecided(runs: Sequence[Run], outcomes: dict[int, Outcomes]) -> list[int]:
    """Runs whose lost episodes could change who is better."""
    lossy = [n for n in outcomes if runs[n].counts.infra_errors]
    return [n for n in lossy if len({_decisions(_test(runs, filled)) for filled in _fillings(outcomes, n)}) > 1]


def _beaten_by(run: int, runs: Sequence[Run], pairs: Sequence[Pair]) -> int:
    """Number of runs without privilege that are better than ``run`` beyond chance."""
    winners = [pair.better for pair in pairs if run in (pair.first, pair.second)]
    return sum(runs[winner].honest for winner in winners if winner not in (None, run))


def _test(runs: Sequence[Run], outcomes: dict[int, Outcomes]) -> list[Pair]:
    tables = []
    for first, second in combinations(sorted(outcomes), 2):
        if (runs[first].task, runs[first].protocol) == (runs[second].task, runs[second].protocol):
            a, b = outcomes[first], outcomes[second]
            counted = a.eligible & b.eligible
            if counted.any():
                tables.append((first, second, pair_table(a.success, b.success, counted)))
    adjusted = holm([midp_mcnemar(table) for _, _, table in tables])
    return [Pair(first, second, table, p) for (first, second, table), p in zip(tables, adjusted, strict=True)]


def _fillings(outcomes: dict[int, Outcomes], run: int) -> list[dict[int, Outcomes]]:
    """The outcomes as measured, and with the lost episodes of a run failed or solved."""
    found, lost = outcomes[run], ~outcomes[run].eligible
    everything = found.eligible | lost
    fillings = [found, replace(found, eligible=everything)]
    fillings.append(replace(found, eligible=everything, success=found.success | lost))
    return [{**outcomes, run: filled} for filled in fillings]


def _decisions(pairs: Sequence[Pair]) -> frozenset[tuple[int, int, int | None]]:
    return frozenset((pair.first, pair.second, pair.better) for pair in pairs)


def _letters(runs: Sequence[Run], ranked: Sequence[int], pairs: Sequence[Pair]) -> dict[int, str]:
    """Letters within each task and protocol that has at least two ranked runs, best first."""
    letters: dict[int, str] = {}
    for group in dict.fromkeys((runs[n].task, runs[n].protocol) for n in ranked):
        members = [n for n in ranked if (runs[n].task, runs[n].protocol) == group]
        members.sort(key=lambda n: -(runs[n].counts.rate or 0.0))
        place = {n: position for position, n in enumerate(members)}
        different = {
            (place[pair.first], place[pair.second]) for pair in pairs if pair.first in place and pair.better is not None
        }
        if len(members) > 1:
            letters |= dict(zip(members, tie_letters(len(members), different), strict=True))
    return letters
