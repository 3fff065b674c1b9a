"""The board of a generalisation suite: policies by ``hard``, the mean of its axes.

Ranked by ``hard`` itself: retention (``hard`` over the clean rate) would reward weak policies. Two policies share a
letter where the difference of their ``hard`` is not significant: a bootstrap over clean scenarios, the same draws for
both, adjusted for all pairs of the suite (Holm). Policies that were trained on changed situations are ranked apart:
what the suite asks of the others, to carry over what was never shown, is not asked of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import norm

from evaluator.leaderboard.copies import near_copies
from evaluator.leaderboard.eligibility import obstacles
from evaluator.leaderboard.ranking import LEVEL
from evaluator.run.cells import RESAMPLES, SuiteScore, score_of, solved
from evaluator.run.run import Run
from evaluator.statistics import holm, tie_letters

__all__ = ["BOARD_SUITE", "SuiteRow", "suite_rows"]

BOARD_SUITE = "hard-v1"
"""The suite whose score stands beside the clean rates."""


@dataclass(frozen=True, slots=True)
class SuiteRow:
    """One policy on one task of a suite."""

    policy: str
    tag: str
    adapted: bool  # trained on changed situations: ranked apart
    suite: str
    task: str
    score: SuiteScore
    clean: float | None  # rate of the same policy over the clean scenarios, where it is on the board
    rank: int | None
    ties: str
    unranked: str  # why it has no rank
    verified: str
    policy_digest: str
    source: str

    @property
    def same_policy(self) -> tuple[str, str, str]:
        """As in ``Run``."""
        return self.task, self.policy, self.policy_digest or self.source

    @property
    def retention(self) -> float | None:
        """``hard`` as a share of the clean rate."""
        return None if not self.clean or self.score.hard is None else self.score.hard / self.clean


def suite_rows(runs: Sequence[Run], clean: Mapping[tuple[str, str, str], float | None]) -> list[SuiteRow]:
    """Rows of the runs over suites, best first; ``clean`` has clean rates by ``Run.same_policy``.

    An entry whose actions were not simulated has no score, and is left out. A run with almost the actions of an earlier
    one has no rank, and is in no pair; nor has one that lost a scenario to the infrastructure, and so has no mean.
    """
    known = [run for run in runs if run.suite and run.has_counts]
    found = [solved(run) for run in known]
    reasons = [next((one.reason for one in obstacles(run)), "") for run in known]
    for n, (own, _, _) in enumerate(found):
        if not reasons[n] and not own.whole:
            reasons[n] = "scenarios that its mean needs have no result"
    for n, original in near_copies(known, [n for n, reason in enumerate(reasons) if not reason]).items():
        reasons[n] = f"almost all of its actions are those of {known[original].policy}"
    ranked = [n for n, reason in enumerate(reasons) if not reason]
    again = {n: found[n][0].hard_again for n in ranked}
    pairs = [(a, b) for a, b in combinations(ranked, 2) if _group(known[a]) == _group(known[b])]
    adjusted = holm([_p(again[a] - again[b]) for a, b in pairs])
    different = {pair for pair, p in zip(pairs, adjusted, strict=True) if p <= LEVEL}
    scores = {n: score_of(run.task, *found[n]) for n, run in enumerate(known)}
    order = sorted(range(len(known)), key=lambda n: (scores[n].hard is None, -(scores[n].hard or 0.0)))
    letters: dict[int, str] = {}
    for group in {_group(run) for run in known}:
        members = [n for n in order if n in again and _group(known[n]) == group]
        place = {n: position for position, n in enumerate(members)}
        apart = {(place[a], place[b]) for a, b in different if a in place}
        if len(members) > 1:
            letters |= dict(zip(members, tie_letters(len(members), apart), strict=True))
    rows = []
    for n in order:
        run = known[n]
        better = [
            other
            for pair in different
            if n in pair
            for other in pair
            if other != n and known[other].honest and (scores[other].hard or 0.0) > (scores[n].hard or 0.0)
        ]
        rows.append(
            SuiteRow(
                run.policy,
                run.tag,
                run.adapted,
                run.suite,
                run.task,
                scores[n],
                clean.get(run.same_policy),
                1 + len(better) if n in again and run.honest else None,
                letters.get(n, ""),
                reasons[n],
                run.verified,
                run.provenance.policy_digest,
                str(run.source),
            )
        )
    return rows


def _group(run: Run) -> tuple[str, str, bool]:
    """What is ranked together."""
    return run.task, run.suite, run.adapted


def _p(differences: np.ndarray) -> float:
    """Two-sided p value of a difference of zero.

    Below the 2 in ``RESAMPLES`` that counting can show, it is that of a normal distribution: with many pairs on the
    board a floor would make every one of them a tie.
    """
    below, above = float((differences <= 0).mean()), float((differences >= 0).mean())
    if min(below, above) > 0:
        return min(1.0, 2 * min(below, above))
    spread = float(differences.std())
    tail = 2 * float(norm.sf(abs(float(differences.mean())) / spread)) if spread else 0.0
    return min(tail, 2 / RESAMPLES)
