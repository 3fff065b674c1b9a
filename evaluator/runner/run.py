"""One evaluation: observe, infer, simulate for every step of the protocol, then the tables and the summary."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from evaluator.engines import InfraError, default_workers
from evaluator.engines.child import call_in_child
from evaluator.episodes import episodes_table, timings_table, to_parquet, verdict
from evaluator.records import Ledger
from evaluator.runner.backend import Backend, default_backend
from evaluator.runner.bank import ObservationBank
from evaluator.runner.config import EvaluationConfig, EvaluationResult, ProgressSink, Silent
from evaluator.runner.folder import RunFolder
from evaluator.runner.infer import check_faults, infer_batches
from evaluator.runner.observe import batches, observe_batches
from evaluator.runner.plan import Plan
from evaluator.runner.simulate import pending_jobs, simulate_jobs
from evaluator.runner.summary import PHASES, summarise
from evaluator.scenarios import ScenarioList, load_list
from rema_data.errors import InfrastructureError, InputError, PolicyFailureError
from rema_data.schema import Situation
from rema_data.storage import rema_home

__all__ = ["INFRA_LIMIT", "run_evaluation"]

INFRA_LIMIT = 0.001
"""Largest share of episodes that may be lost to the infrastructure."""


def run_evaluation(
    config: EvaluationConfig, progress: ProgressSink | None = None, *, backend: Backend | None = None
) -> EvaluationResult:
    """Evaluate a policy, or go on with an evaluation that was interrupted.

    Parameters
    ----------
    config : EvaluationConfig
        A run folder that exists is resumed: what is recorded there is neither asked nor simulated again.
    progress : ProgressSink, optional
    backend : Backend, optional
        The real world by default.

    Returns
    -------
    EvaluationResult

    Raises
    ------
    InputError
        More episodes than the list has; a folder that another process writes in.
    MissingFileError, IntegrityError
        The scenario list is not there, or not the frozen one; records are damaged.
    RunMismatchError
        The folder belongs to another policy, task, protocol, scenario list or simulator.
    SubmissionError
        The policy cannot be loaded.
    PolicyFailureError
        More than 10 % of its answers are faults. Everything recorded stays in the folder, with its tables.
    InfrastructureError
        More than 0.1 % of the episodes were lost, or a step had two different outcomes; after everything is written.
    StorageError
        The disk is full; run again when it is not.
    KeyboardInterrupt
        Workers are stopped; run again to go on.
    """
    start = time.perf_counter()
    progress = progress or Silent()
    backend = backend or default_backend()
    scenarios = load_list(config.task, config.split)
    if config.episodes > len(scenarios.scenarios):
        raise InputError(
            f"--episodes {config.episodes} is more than the {len(scenarios.scenarios)} scenarios of "
            f"{config.task}/{config.split}",
            hint=f"give {len(scenarios.scenarios)} or less",
            episodes=config.episodes,
        )
    identity = {
        "task": config.task,
        "split": config.split,
        "protocol": config.protocol,
        "policy_digest": backend.policy_digest(config.policy, config.checkpoint),
        "protocol_hash": backend.protocol_hash(config.task, config.protocol),
        "scenarios_hash": scenarios.sha256,
        "fingerprint": call_in_child(backend.fingerprint),
    }
    with RunFolder.locked(config.output, identity, config.episodes) as folder:
        folder.set_policy(name=config.policy.name, file=config.policy.path.name, class_name=config.policy.class_name)
        return _Run(config, progress, backend, scenarios, folder, start).go()


class _Run:
    """An evaluation inside its locked folder."""

    def __init__(
        self,
        config: EvaluationConfig,
        progress: ProgressSink,
        backend: Backend,
        scenarios: ScenarioList,
        folder: RunFolder,
        start: float,
    ) -> None:
        self.config, self.progress, self.backend = config, progress, backend
        self.scenarios, self.folder, self.start = scenarios, folder, start
        self.plan = Plan(scenarios.scenarios[: config.episodes], config.task, config.protocol)
        self.ledger = Ledger(folder.records, folder.segment)
        self.seconds = dict.fromkeys(PHASES, 0.0)
        self.own_bank = folder.path / ".observations"

    def go(self) -> EvaluationResult:
        done = self._finished()
        if done:
            earlier = len(self.folder.header["segments"])
            self.progress.note(f"resumed at {done:,}/{self.config.episodes:,} after {earlier} segments")
        failed: PolicyFailureError | None = None
        try:
            try:
                for step in self.plan.steps:
                    self._step(step)
                check_faults(self.ledger)
            except PolicyFailureError as error:
                failed = error
                if self.folder.policy_log.exists():
                    failed.hint += f"\nwhat it printed is in {self.folder.policy_log}"
            self._write_tables()
        finally:
            self.ledger.close()
            self.seconds["total"] = time.perf_counter() - self.start
            rounded = {phase: round(seconds, 3) for phase, seconds in self.seconds.items()}
            self.folder.note_segment(seconds=rounded, finished=self._finished() - done)
        result = self._write_summary()
        if failed is not None:
            raise failed
        self._check_infrastructure(result.summary)
        return result

    def _finished(self) -> int:
        ends = (verdict(scenario.index, self.plan.steps, self.ledger) for scenario in self.plan.scenarios)
        return sum(end.success is not None for end in ends)

    @contextmanager
    def _timed(self, phase: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[phase] += time.perf_counter() - start

    def _begin(self) -> None:
        config = self.config
        workers = 1 if config.engine == "inline" else config.workers or default_workers()
        self.folder.begin_segment(
            engine=config.engine, workers=workers, batch_size=config.batch_size, order=config.order
        )

    def _step(self, step: int) -> None:
        alive = self.plan.alive(step, self.ledger)
        if any((index, step) not in self.ledger.answers for index in alive):
            self._ask(step, alive)
        jobs = pending_jobs(alive, step, self.ledger)
        if jobs:
            self._begin()
            with self._timed("simulate"):
                simulate_jobs(jobs, step, self.config, self.backend.simulator, self.ledger, self.progress)

    def _ask(self, step: int, alive: dict[int, Situation]) -> None:
        config, backend = self.config, self.backend
        wanted = [
            batch
            for batch in batches(alive, config.batch_size)
            if any((index, step) not in self.ledger.answers for index in batch.indices)
        ]
        if config.order == "reverse":
            wanted.reverse()
        # Situations of later end-to-end steps come from the policy's own picks: of no use to any other run.
        shared = step == 0 or not self.plan.end_to_end
        root = rema_home() / "observations" if shared else self.own_bank
        bank = ObservationBank(root, backend.observe, backend.observation_hash)
        log = self.folder.policy_log
        # Started before anything is observed: a policy that cannot be loaded is to be known at once.
        with ExitStack() as stack:
            with self._timed("infer"):
                policy = stack.enter_context(backend.open_policy(config.policy, config.checkpoint, config.device, log))
            with self._timed("observe"):
                observe_batches(bank, wanted, self.progress)
            with self._timed("infer"):
                self._begin()
                self.folder.set_policy(privileged=policy.privileged)
                valid = backend.valid_actions(config.task, step)
                infer_batches(policy, bank, wanted, valid, self.ledger, self.progress)

    def _write_tables(self) -> None:
        table = episodes_table(self.scenarios, self.config.episodes, self.plan.steps, self.ledger)
        self.folder.write("episodes.parquet", to_parquet(table))
        self.folder.write("timings.parquet", to_parquet(timings_table(self.ledger, self.config.episodes)))

    def _write_summary(self) -> EvaluationResult:
        summary = summarise(self.config, self.plan, self.ledger, self.folder.header)
        self.folder.write("summary.json", json.dumps(summary, indent=2) + "\n")
        shutil.rmtree(self.own_bank, ignore_errors=True)
        return EvaluationResult(self.folder.path, summary)

    def _check_infrastructure(self, summary: dict[str, Any]) -> None:
        lost = {
            key: record.outcome
            for key, record in self.ledger.outcomes.items()
            if isinstance(record.outcome, InfraError)
        }
        if self.ledger.contradictions:
            index, step = self.ledger.contradictions[0]
            raise InfrastructureError(
                f"{len(self.ledger.contradictions)} steps had two different outcomes, the first one step {step} of "
                f"scenario {index}: the simulator is not deterministic here",
                hint="do not use these numbers; report the run folder",
                contradictions=self.ledger.contradictions,
            )
        if summary["infra_errors"] > INFRA_LIMIT * summary["episodes"]:
            (index, step), error = next(iter(lost.items()))
            low, high = summary["success_rate_bounds"]
            raise InfrastructureError(
                f"{summary['infra_errors']} of {summary['episodes']} episodes were lost to the infrastructure "
                f"(limit {INFRA_LIMIT:.1%}), the first one step {step} of scenario {index}: {error.reason}: "
                f"{error.detail.strip().splitlines()[-1]}; the success rate lies between {low:.1%} and {high:.1%}",
                hint="run the same command again: it tries them once more",
                infra_errors=summary["infra_errors"],
                folder=str(self.folder.path),
            )
