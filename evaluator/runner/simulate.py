"""Phase three of a step: the recorded actions through an engine, the outcomes into the ledger."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing

from evaluator.engines import Engine, InfraError, Job, make_engine
from evaluator.records import Ledger, Simulated
from evaluator.runner.config import EvaluationConfig, ProgressSink
from evaluator.runner.plan import arrange, shards
from rema_data.schema import Situation, StepOutcome

__all__ = ["pending_jobs", "simulate_jobs"]


def pending_jobs(alive: Mapping[int, Situation], step: int, ledger: Ledger) -> list[Job]:
    """Jobs of the episodes that have an action for ``step`` and no outcome; infrastructure errors are tried again."""
    jobs = []
    for index, situation in alive.items():
        answer = ledger.answers.get((index, step))
        if answer is None or answer.action is None:
            continue
        if not isinstance(ledger.result(index, step), StepOutcome):
            jobs.append(Job(index, situation, answer.action))
    return jobs


def simulate_jobs(
    jobs: list[Job], step: int, config: EvaluationConfig, simulator: str, ledger: Ledger, progress: ProgressSink
) -> None:
    """Run jobs and record what came of them.

    Raises
    ------
    InfrastructureError
        Workers cannot be started.
    StorageError
        The disk is full.
    """
    progress.phase("simulate", len(jobs))
    ordered = arrange(jobs, config.order, [job.key for job in jobs])
    engine: Engine = make_engine(config.engine, config.workers, simulator)
    with closing(engine):
        for results in engine.map(shards(ordered)):
            ledger.add_outcomes(
                Simulated(
                    result.key, step, result.outcome, result.seconds, result.worker, result.attempt, ledger.segment
                )
                for result in results
            )
            progress.advance(len(results))
            for result in results:
                if isinstance(result.outcome, InfraError):
                    progress.note(f"scenario {result.key} was given up: its worker {result.outcome.reason} twice")
                elif result.attempt > 1:
                    progress.note(f"scenario {result.key} lost its worker once and was redone")
