"""The counts of a run, which follow from its rows; every reader counts them again."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
from pydantic import NonNegativeInt

from evaluator.run.plan import Plan
from evaluator.statistics import error_bounds, rate_interval
from rema_data.schema import Failure
from rema_data.validation import record

__all__ = ["Counts", "FunnelStep", "count_rows", "same_numbers", "summary_numbers", "unfinished"]

_TOLERANCE = 1e-9


@record
class FunnelStep:
    """How many episodes reached a step (``attempted``) and passed it (``succeeded``)."""

    step: NonNegativeInt
    attempted: NonNegativeInt
    succeeded: NonNegativeInt


@record
class Counts:
    """The counts behind a rate."""

    episodes: NonNegativeInt  # scenarios of the run
    eligible: NonNegativeInt  # measured: the denominator
    successes: NonNegativeInt
    failures: dict[str, NonNegativeInt]  # failed episodes by label
    policy_errors: NonNegativeInt  # failures without a valid answer: in the denominator
    infra_errors: NonNegativeInt  # lost to the infrastructure: not in the denominator
    funnel: tuple[FunnelStep, ...]  # of the steps in which the policy acts

    @property
    def rate(self) -> float | None:
        """Success rate, a share in 0..1; None where no episode is eligible."""
        return self.successes / self.eligible if self.eligible else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of the rate (``rate_interval``); None where no episode is eligible."""
        return rate_interval(self.successes, self.eligible) if self.eligible else None

    @property
    def bounds(self) -> tuple[float, float] | None:
        """The rate if all episodes lost to the infrastructure had failed, and if all had succeeded."""
        if not self.eligible + self.infra_errors:
            return None
        return error_bounds(self.successes, self.eligible, self.infra_errors)

    def add_up(self, steps: Sequence[int]) -> bool:
        """Whether every sum fits, for a policy that acts in ``steps``."""
        return (
            self.episodes > 0
            and self.eligible + self.infra_errors <= self.episodes
            and self.successes + sum(self.failures.values()) == self.eligible
            and self.policy_errors == self.failures.get(Failure.POLICY_ERROR.value, 0)
            and tuple(step.step for step in self.funnel) == tuple(steps)
            and all(step.succeeded <= step.attempted for step in self.funnel)
            and self.funnel[-1].succeeded == self.successes
        )


def count_rows(table: pa.Table, steps: Sequence[int]) -> Counts:
    """Counts of the rows of a results table, for a policy that acts in ``steps``."""
    measured = [success for success in table.column("success").to_pylist() if success is not None]
    failures = Counter(label for label in table.column("failure").to_pylist() if label is not None)
    funnel = []
    for step in steps:
        outcomes = [success for success in table.column(f"step{step}_success").to_pylist() if success is not None]
        funnel.append(FunnelStep(step, len(outcomes), sum(outcomes)))
    return Counts(
        episodes=table.num_rows,
        eligible=len(measured),
        successes=sum(measured),
        failures=dict(sorted(failures.items())),
        policy_errors=failures[Failure.POLICY_ERROR.value],
        infra_errors=table.num_rows - table.column("infra_error").null_count,
        funnel=tuple(funnel),
    )


def summary_numbers(counts: Counts, table: pa.Table) -> dict[str, Any]:
    """What ``summary.json`` says about the rows of a results table, ready for JSON.

    ``success_rate`` and ``ci95`` are null where no episode is eligible; ``failures`` begin with the most common.
    """
    numbers = {
        "episodes": counts.episodes,
        "eligible": counts.eligible,
        "successes": counts.successes,
        "success_rate": counts.rate,
        "ci95": counts.interval,
        "success_rate_bounds": counts.bounds,
        "failures": dict(sorted(counts.failures.items(), key=lambda item: (-item[1], item[0]))),
        "policy_errors": counts.policy_errors,
        "infra_errors": counts.infra_errors,
        "funnel": [
            {
                "step": step.step,
                "attempted": step.attempted,
                "succeeded": step.succeeded,
                "rate": step.succeeded / step.attempted if step.attempted else None,
                "infra_errors": _lost(table, step.step),
            }
            for step in counts.funnel
        ],
        "sim_steps": sum(count or 0 for count in table.column("sim_steps").to_pylist()),
    }
    plain: dict[str, Any] = json.loads(json.dumps(numbers))
    return plain


def _lost(table: pa.Table, step: int) -> int:
    """Episodes that were lost to the infrastructure in a step."""
    names = (f"step{step}_success", f"step{step}_action", "infra_error")
    rows = zip(*(table.column(name).to_pylist() for name in names), strict=True)
    return sum(success is None and action is not None and error is not None for success, action, error in rows)


def same_numbers(found: Any, expected: Any) -> bool:
    """Equal, but for the last bits of a fraction, which another machine or another scipy may round differently."""
    if isinstance(expected, float) and isinstance(found, int | float) and not isinstance(found, bool):
        return math.isclose(found, expected, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    if isinstance(expected, dict) and isinstance(found, dict):
        return expected.keys() == found.keys() and all(same_numbers(found[name], expected[name]) for name in expected)
    if isinstance(expected, list) and isinstance(found, list):
        return len(expected) == len(found) and all(map(same_numbers, found, expected))
    return type(found) is type(expected) and bool(found == expected)


def unfinished(plan: Plan, table: pa.Table) -> int:
    """Number of episodes that have no result though the protocol can be run on them: 0 unless a run was cut short."""
    ends = zip(table.column("success").to_pylist(), table.column("infra_error").to_pylist(), strict=True)
    return sum(
        success is None and error is None and plan.eligible(scenario)
        for scenario, (success, error) in zip(plan.scenarios, ends, strict=True)
    )
