"""``summary.json``: the numbers of a run, computed from its records."""

from __future__ import annotations

from collections import Counter
from typing import Any

from evaluator.engines import InfraError, default_workers
from evaluator.episodes import verdict
from evaluator.records import Ledger
from evaluator.runner.config import EvaluationConfig
from evaluator.runner.plan import Plan
from evaluator.statistics import wilson
from rema_data.schema import StepOutcome

__all__ = ["PHASES", "summarise"]

PHASES = ("observe", "infer", "simulate", "total")


def summarise(config: EvaluationConfig, plan: Plan, ledger: Ledger, header: dict[str, Any]) -> dict[str, Any]:
    """The content of ``summary.json``.

    Parameters
    ----------
    config : EvaluationConfig
    plan : Plan
    ledger : Ledger
    header : dict
        Content of ``run.json``.

    Returns
    -------
    dict
        ``success_rate`` and ``ci95`` (Wilson) are over the eligible episodes: those that were measured. They are null
        where there is none. ``success_rate_bounds`` counts the infrastructure errors as failures, then as successes.
        ``seconds`` and ``episodes_per_second`` are sums over the segments that ended in an orderly way.
    """
    verdicts = [verdict(scenario.index, plan.steps, ledger) for scenario in plan.scenarios]
    measured = [end for end in verdicts if end.success is not None]
    eligible, successes = len(measured), sum(end.success is True for end in measured)
    failures = Counter(end.failure.value for end in measured if end.failure is not None)
    errors = sum(end.infra_error is not None for end in verdicts)
    counted = eligible + errors
    seconds, rate = _time(header["segments"])
    faults = Counter(str(answer.reason) for answer in ledger.answers.values() if answer.action is None)
    identity = header["identity"]
    return {
        "task": config.task,
        "split": config.split,
        "policy": config.policy.name,
        "privileged": header["policy"].get("privileged"),
        "protocol": config.protocol,
        "episodes": len(verdicts),
        "eligible": eligible,
        "successes": successes,
        "success_rate": successes / eligible if eligible else None,
        "ci95": list(wilson(successes, eligible)) if eligible else None,
        "success_rate_bounds": [successes / counted, (successes + errors) / counted] if counted else None,
        "failures": dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        "policy_errors": sum(faults.values()),
        "policy_error_reasons": dict(sorted(faults.items())),
        "infra_errors": errors,
        "nondeterministic": len(ledger.contradictions),
        "funnel": _funnel(plan, ledger),
        "sim_steps": sum(
            record.outcome.sim_steps for record in ledger.outcomes.values() if isinstance(record.outcome, StepOutcome)
        ),
        "seconds": seconds,
        "episodes_per_second": rate,
        "engine": config.engine,
        "workers": 1 if config.engine == "inline" else config.workers or default_workers(),
        "segments": len(header["segments"]),
        "policy_digest": identity["policy_digest"],
        "protocol_hash": identity["protocol_hash"],
        "scenarios_hash": identity["scenarios_hash"],
        "fingerprint": identity["fingerprint"],
    }


def _funnel(plan: Plan, ledger: Ledger) -> list[dict[str, Any]]:
    """How many episodes reached, passed and lost each step that the policy acts in."""
    rows = []
    for step in plan.steps:
        results = [ledger.result(scenario.index, step) for scenario in plan.scenarios]
        outcomes = [result for result in results if isinstance(result, StepOutcome)]
        passed = sum(outcome.success for outcome in outcomes)
        rows.append(
            {
                "step": step,
                "attempted": len(outcomes),
                "succeeded": passed,
                "rate": passed / len(outcomes) if outcomes else None,
                "infra_errors": sum(isinstance(result, InfraError) for result in results),
            }
        )
    return rows


def _time(segments: list[dict[str, Any]]) -> tuple[dict[str, float], float | None]:
    """Seconds by phase, and finished episodes a second, over the segments that say how long they took."""
    timed = [segment for segment in segments if "seconds" in segment]
    seconds = {phase: round(sum(segment["seconds"][phase] for segment in timed), 3) for phase in PHASES}
    finished = sum(segment["finished"] for segment in timed)
    return seconds, round(finished / seconds["total"], 3) if seconds["total"] else None
