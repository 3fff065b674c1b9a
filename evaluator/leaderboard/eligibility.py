"""The conditions of a rank: a full frozen test list, the current protocol, a name of its own, simulated results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from evaluator.leaderboard.naming import name_problem
from evaluator.leaderboard.verification import why_not
from evaluator.protocol import ACTION_FLIP_LIMIT, FAULT_LIMIT, INFRA_LIMIT, protocol_hash
from evaluator.run.counts import Counts
from evaluator.run.run import Run
from evaluator.scenarios import SPLITS, VERSION, installed_list

__all__ = ["Check", "obstacles", "rank_checks"]


@dataclass(frozen=True, slots=True)
class Check:
    """One condition of a rank, or of a submission."""

    what: str  # the field
    passed: bool
    required: str  # what it must be
    found: str  # what it is
    reason: str = ""  # in a few words, why a run that does not meet it has no rank


def rank_checks(run: Run) -> list[Check]:
    """Every condition of a rank, the weightiest first, and whether a run meets it.

    An entry holds no results and no audit: what they would have to be is not among its conditions.
    """
    episodes, test, hashes = len(run.actions) if run.has_actions else run.counts.episodes, SPLITS[0], run.provenance
    sha256, count = installed_list(run.task, test, run.suite or VERSION) or ("", 0)
    same_list = bool(sha256) and hashes.scenarios_hash == sha256
    ours, problem = protocol_hash(run.task, run.protocol), name_problem(run)
    return [
        Check("split", run.split == test, test, run.split, f"{run.split} split"),
        Check("stopped_early", not run.stopped_early, "false", str(run.stopped_early).lower(), "stopped early"),
        Check("scenarios_hash", same_list, sha256, hashes.scenarios_hash, "another scenario list"),
        Check("episodes", episodes == count, str(count), str(episodes), f"{episodes:,} of {count:,} scenarios"),
        Check("protocol_hash", hashes.protocol_hash == ours, ours, hashes.protocol_hash, "another protocol version"),
        *_suite_checks(run),
        Check("name", not problem, "its own", problem or "ok", problem),
        *(_answers(run.counts) if run.has_counts else ()),
        *(_run_checks(run) if run.kind == "run" else ()),
    ]


def _suite_checks(run: Run) -> Iterator[Check]:
    """A suite changes the last step, as the conditional protocol plays it; another one is not its score."""
    if run.suite:
        played = run.protocol
        yield Check("protocol", played == "conditional", "conditional", played, f"a suite is not played {played}")


def _answers(counts: Counts) -> Iterator[Check]:
    """A policy that does not answer is no policy: `rema evaluate` stops there, and an entry has no rank."""
    limit = int(FAULT_LIMIT * counts.eligible)
    found = f"{counts.policy_errors:,} of {counts.eligible:,} episodes without a valid answer"
    yield Check("policy_errors", counts.policy_errors <= limit, f"at most {limit}", str(counts.policy_errors), found)


def _run_checks(run: Run) -> list[Check]:
    """Conditions on what happened while a run was played."""
    counts, audit, limit = run.counts, run.audit, int(INFRA_LIMIT * run.counts.episodes)
    repeated, outcome_flips, flips, limit_flips = run.stopped_early, 0, 0, 0.0
    if audit is not None:
        repeated, outcome_flips = True, audit.outcome_flips
        flips, limit_flips = audit.action_flips, ACTION_FLIP_LIMIT * audit.actions
    found = "no repeats" if audit is None else f"{outcome_flips} of {audit.outcomes} repeated outcomes flipped"
    answers = "no repeats" if audit is None else f"{flips} of {audit.actions} repeated answers differed"
    return [
        Check("unfinished", not run.unfinished, "0", str(run.unfinished), f"{run.unfinished:,} episodes not finished"),
        Check(
            "infra_errors",
            counts.infra_errors <= limit,
            f"at most {limit}",
            str(counts.infra_errors),
            f"{counts.infra_errors:,} episodes lost to the infrastructure",
        ),
        Check("nondeterministic", not run.nondeterministic, "0", str(run.nondeterministic), "steps with two outcomes"),
        Check(
            "audit",
            repeated and not outcome_flips,
            "repeats, and no outcome that flipped",
            found,
            found if repeated else "never repeated",
        ),
        Check("actions", flips <= limit_flips, f"at most {ACTION_FLIP_LIMIT:.0%} action flips", answers, answers),
    ]


def obstacles(run: Run) -> list[Check]:
    """The conditions that keep a run from being ranked, the weightiest first; empty for a run that is."""
    failed = [check for check in rank_checks(run) if not check.passed]
    if not run.verified:
        reason = why_not(run)
        failed.append(Check("verified", False, "simulated here or by CI", reason, reason))
    return failed
