"""The numbers of a run that follow from its rows alone: counted at its end, and again by whoever replays it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from evaluator.run.plan import Plan
from evaluator.statistics import wilson
from rema_data.schema import Failure

__all__ = ["same_numbers", "tally", "unfinished"]

_TOLERANCE = 1e-9


def tally(table: pa.Table, steps: Sequence[int]) -> dict[str, Any]:
    """What ``summary.json`` says about the rows of ``episodes.parquet``.

    Parameters
    ----------
    table : pyarrow.Table
    steps : sequence of int
        Steps in which the policy acts.

    Returns
    -------
    dict
        ``success_rate`` and ``ci95`` (Wilson) are over the eligible episodes: those that were measured. They are null
        where there is none. ``success_rate_bounds`` counts the infrastructure errors as failures, then as successes.
    """
    measured = [success for success in table.column("success").to_pylist() if success is not None]
    eligible, successes = len(measured), sum(measured)
    failures = Counter(label for label in table.column("failure").to_pylist() if label is not None)
    errors = table.num_rows - table.column("infra_error").null_count
    counted = eligible + errors
    return {
        "episodes": table.num_rows,
        "eligible": eligible,
        "successes": successes,
        "success_rate": successes / eligible if eligible else None,
        "ci95": list(wilson(successes, eligible)) if eligible else None,
        "success_rate_bounds": [successes / counted, (successes + errors) / counted] if counted else None,
        "failures": dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        "policy_errors": failures[Failure.POLICY_ERROR.value],
        "infra_errors": errors,
        "funnel": [_funnel(table, step) for step in steps],
        "sim_steps": sum(count or 0 for count in table.column("sim_steps").to_pylist()),
    }


def _funnel(table: pa.Table, step: int) -> dict[str, Any]:
    """How many episodes reached, passed and lost a step."""
    names = (f"step{step}_success", f"step{step}_action", "infra_error")
    rows = list(zip(*(table.column(name).to_pylist() for name in names), strict=True))
    outcomes = [success for success, _, _ in rows if success is not None]
    lost = sum(success is None and action is not None and error is not None for success, action, error in rows)
    passed = sum(outcomes)
    return {
        "step": step,
        "attempted": len(outcomes),
        "succeeded": passed,
        "rate": passed / len(outcomes) if outcomes else None,
        "infra_errors": lost,
    }


def same_numbers(found: Any, wanted: Any) -> bool:
    """Equal, but for the last bits of a fraction that another machine, or another scipy, may round otherwise."""
    if isinstance(wanted, float) and isinstance(found, int | float) and not isinstance(found, bool):
        return math.isclose(found, wanted, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    if isinstance(wanted, dict) and isinstance(found, dict):
        return wanted.keys() == found.keys() and all(same_numbers(found[name], wanted[name]) for name in wanted)
    if isinstance(wanted, Sequence) and not isinstance(wanted, str) and isinstance(found, list):
        return len(wanted) == len(found) and all(map(same_numbers, found, wanted))
    return type(found) is type(wanted) and bool(found == wanted)


def unfinished(plan: Plan, table: pa.Table) -> int:
    """Number of episodes that have no result though the protocol can be run on them: 0 unless a run was cut short."""
    ends = zip(table.column("success").to_pylist(), table.column("infra_error").to_pylist(), strict=True)
    return sum(
        success is None and error is None and plan.eligible(scenario)
        for scenario, (success, error) in zip(plan.scenarios, ends, strict=True)
    )
