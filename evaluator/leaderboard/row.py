"""Rows of the leaderboard: a run, or a published rate."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from evaluator.leaderboard.fresh import FreshGap
from evaluator.leaderboard.naming import PUBLISHED, TAGS
from evaluator.leaderboard.published import published_rate, published_table
from evaluator.run.audit import Audit
from evaluator.run.counts import FunnelStep
from evaluator.run.run import Run
from evaluator.statistics import rate_interval, z_against_published

__all__ = ["PUBLISHED", "TAGS", "Row", "published_rows", "row_of"]


@dataclass(frozen=True, slots=True)
class Row:
    """One policy on one task."""

    policy: str
    tag: str  # one of ``TAGS``: ``submitted``, ``learned`` (a built-in network), ``privileged``, ``random``, ...
    task: str
    protocol: str
    split: str
    successes: int | None  # not published by the paper
    episodes: int  # eligible episodes: the denominator
    rate: float | None  # share in 0..1; None where no episode was eligible
    ci95: tuple[float, float] | None  # Wilson; Clopper-Pearson where the rate is 0 or 1
    # rate if all episodes lost to the infrastructure had failed, or succeeded; None: none lost
    bounds: tuple[float, float] | None = None
    policy_errors: int = 0  # this and the next four as in ``Run`` and its counts
    infra_errors: int = 0
    failures: dict[str, int] | None = None
    funnel: tuple[FunnelStep, ...] = ()
    audit: Audit | None = None
    rank: int | None = None  # this and the next two as in ``Standing``
    ties: str = ""
    unranked: str = ""
    verified: str = ""  # as in ``Run``; empty if its actions were not simulated, and for published rows
    end_to_end: float | None = None  # rate over the whole task, on conditional rows of tasks of several steps
    fresh: FreshGap | None = None  # to the rate of the same policy over fresh scenarios
    adapted: bool = False  # as in ``Run``; where there is ``hard``, it says how that was reached
    hard: float | None = None  # of the same policy over the suite of the board, on conditional rows
    # rates of the same policy where a part of the maps is blanked, by protocol, on conditional rows
    blank: dict[str, float] | None = None
    z: float | None = None  # distance to the published rate of the same policy and task, in standard errors
    policy_digest: str = ""  # this, the hashes, ``fingerprint`` and ``isolation`` are empty if published
    protocol_hash: str = ""
    scenarios_hash: str = ""
    fingerprint: str = ""
    source: str = ""
    link: str = ""
    isolation: str = ""

    @property
    def same_policy(self) -> tuple[str, str, str]:
        """As in ``Run``."""
        return self.task, self.policy, self.policy_digest or self.source


def row_of(run: Run, **standing: Any) -> Row:
    """The row of a run; ``standing`` are the fields that depend on the other rows."""
    provenance, z = run.provenance, None
    what = {
        name: getattr(run, name)
        for name in ("policy", "tag", "task", "protocol", "split", "link", "isolation", "adapted")
    }
    what |= {name: getattr(provenance, name) for name in ("policy_digest", "protocol_hash", "scenarios_hash")}
    what |= {"source": str(run.source), **standing}
    if not run.has_counts:
        return Row(successes=None, episodes=0, rate=None, ci95=None, **what)
    counts = run.counts
    # A submitted "joint.py" is not the paper's joint.
    comparable = run.verified and run.protocol == "conditional" and run.tag not in ("submitted", "simulator")
    known = published_rate(run.policy, run.task) if comparable else None
    if known is not None and counts.eligible:
        z, _ = z_against_published(counts.successes, counts.eligible, known, int(published_table()["episodes"]))
    return Row(
        successes=counts.successes,
        episodes=counts.eligible,
        rate=counts.rate,
        ci95=counts.interval,
        bounds=counts.bounds if counts.infra_errors else None,
        policy_errors=counts.policy_errors,
        infra_errors=counts.infra_errors,
        failures=counts.failures,
        funnel=counts.funnel,
        audit=run.audit,
        z=z,
        fingerprint=json.dumps(dict(provenance.fingerprint), sort_keys=True) if provenance.fingerprint else "",
        verified=run.verified,
        **what,
    )


def published_rows() -> list[Row]:
    """The paper's Table 2, lower half."""
    table = published_table()
    count = int(table["episodes"])
    return [
        Row(
            policy=policy,
            tag=PUBLISHED,
            task=task,
            protocol=table["protocol"],
            split="",
            successes=None,
            episodes=count,
            rate=round(percent / 100, 6),
            ci95=rate_interval(round(percent / 100 * count), count),
            unranked=PUBLISHED,
        )
        for policy, rates in table["success_percent"].items()
        for task, percent in rates.items()
    ]
