"""Simulating recorded actions: through an engine, the outcomes into the records."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from evaluator.engines import Engine, InfraError, Job, make_engine
from evaluator.protocol import INFRA_LIMIT
from evaluator.run.plan import arrange, job_batches
from evaluator.run.records import Ledger, Records, Simulated
from rema_data.errors import InfrastructureError
from rema_data.progress import Progress
from rema_data.schema import Situation, StepOutcome

__all__ = ["check_infrastructure", "pending_jobs", "simulate_jobs"]


def pending_jobs(alive: Mapping[int, Situation], step: int, records: Records) -> list[Job]:
    """Jobs of the episodes that have an action for ``step`` and no outcome; infrastructure errors are tried again."""
    jobs = []
    for index, situation in alive.items():
        answer = records.answers.get((index, step))
        if answer is None or answer.action is None:
            continue
        if not isinstance(records.result(index, step), StepOutcome):
            jobs.append(Job(index, situation, answer.action))
    return jobs


def simulate_jobs(
    jobs: list[Job],
    steps: Mapping[int, tuple[int, int]],
    records: Records,
    progress: Progress,
    *,
    simulator: str,
    engine: str,
    workers: int | None,
    order: str,
    address: str | None = None,
) -> None:
    """Run jobs and record their outcomes; raises InfrastructureError where workers cannot be started.

    ``steps`` gives the (index, step) of a job's key; ``progress`` has begun its phase; ``engine``, ``workers``,
    ``order`` and ``address`` are those of ``EvaluationConfig``.
    """
    ordered = arrange(jobs, order, [job.key for job in jobs])
    running: Engine
    with closing(make_engine(engine, workers, simulator, address=address)) as running:
        for results in running.map(job_batches(ordered)):
            records.add_outcomes(
                Simulated(
                    *steps[result.key], result.outcome, result.seconds, result.worker, result.attempt, records.segment
                )
                for result in results
            )
            progress.advance(len(results))
            for result in results:
                index, _ = steps[result.key]
                if isinstance(result.outcome, InfraError):
                    progress.note(f"scenario {index} was given up: its worker {result.outcome.reason} twice")
                elif result.attempt > 1:
                    progress.note(f"scenario {index} lost its worker once and was redone")


def check_infrastructure(ledger: Ledger, summary: dict[str, Any], folder: Path) -> None:
    """Raise InfrastructureError where over 0.1 % of the episodes were lost or a step had two different outcomes."""
    lost = {key: record.outcome for key, record in ledger.outcomes.items() if isinstance(record.outcome, InfraError)}
    if ledger.contradictions:
        index, step = ledger.contradictions[0]
        raise InfrastructureError(
            f"{len(ledger.contradictions)} steps had two different outcomes, the first one step {step} of "
            f"scenario {index}: the simulator is not deterministic here",
            hint="do not use these numbers; report the run folder",
            contradictions=ledger.contradictions,
        )
    if summary["infra_errors"] > INFRA_LIMIT * summary["episodes"]:
        (index, step), error = next(iter(lost.items()))
        low, high = summary["success_rate_bounds"]
        raise InfrastructureError(
            f"{summary['infra_errors']} of {summary['episodes']} episodes were lost to the infrastructure "
            f"(limit {INFRA_LIMIT:.1%}), the first one step {step} of scenario {index}: {error.reason}: "
            f"{error.detail.strip().splitlines()[-1]}; the success rate lies between {low:.1%} and {high:.1%}",
            hint="run the same command again: it tries them again",
            infra_errors=summary["infra_errors"],
            folder=str(folder),
        )
