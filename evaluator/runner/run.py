"""One evaluation: observe, infer, simulate for every step of the protocol; then tables, audit, summary and seal."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Any

import pyarrow as pa

from evaluator.engines import default_workers, worker_count
from evaluator.engines.child import call_in_child
from evaluator.policy.wire import TAGS
from evaluator.rollout.backend import Backend, PolicyProcess, check_digest, default_backend
from evaluator.rollout.blank import showing
from evaluator.rollout.simulate import check_infrastructure, pending_jobs, simulate_jobs
from evaluator.run.folder import RunFolder
from evaluator.run.plan import Plan
from evaluator.run.records import Ledger
from evaluator.run.seal import ACTIONS_FILE
from evaluator.run.summary import PHASES
from evaluator.run.tables import verdict
from evaluator.runner.audit import ask_again, audit_summary, jobs_again, repeats, seed_of
from evaluator.runner.config import EvaluationConfig, EvaluationResult
from evaluator.runner.finalize import remember_run, seal_run, write_tables
from evaluator.runner.observation_cache import ObservationCache
from evaluator.runner.questions import batches, check_faults, infer_batches, observe_batches, shuffled
from evaluator.scenarios import ScenarioList, load_list
from rema_data.errors import InputError, PolicyFailureError, SubmissionError
from rema_data.progress import Progress, Silent
from rema_data.schema import Situation
from rema_data.storage import rema_home

__all__ = ["Look", "run_evaluation"]

Look = Callable[[pa.Table], dict[str, Any]]


def run_evaluation(
    config: EvaluationConfig,
    progress: Progress | None = None,
    *,
    backend: Backend | None = None,
    look: Look | None = None,
) -> EvaluationResult:
    """Evaluate a policy, or continue an evaluation that was interrupted: what the run folder records is not done again.

    ``backend`` is the real world by default. ``look`` makes of the results table what the summary says under
    ``stopped_early``: such a run has no rank.

    Raises InputError (more episodes than the list has, or a folder in use), MissingFileError and IntegrityError (the
    scenario list or the records), RunMismatchError (the folder belongs to another run), SubmissionError (the policy
    cannot be loaded), StorageError (the disk is full), PolicyFailureError (more than 10 % faults; records and tables
    stay in the folder) and InfrastructureError (more than 0.1 % lost, or a step had two different outcomes; after
    everything is written). A KeyboardInterrupt stops the workers; run again to continue.
    """
    start = time.perf_counter()
    progress = progress or Silent()
    backend = backend or default_backend()
    scenarios = load_list(config.task, config.split, config.version)
    if config.episodes > len(scenarios.scenarios):
        raise InputError(
            f"--episodes {config.episodes} is more than the {len(scenarios.scenarios)} scenarios of "
            f"{config.task}/{config.split}",
            hint=f"give {len(scenarios.scenarios)} or less",
            episodes=config.episodes,
        )
    with backend.hold_policy(config.policy, config.checkpoint, config.output) as policy:
        config = replace(config, policy=policy)
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
            folder.set_policy(name=policy.name, file=policy.path.name, class_name=policy.class_name)
            return _Run(config, progress, backend, scenarios, folder, start, look).go()


class _Run:
    """An evaluation inside its locked folder."""

    def __init__(
        self,
        config: EvaluationConfig,
        progress: Progress,
        backend: Backend,
        scenarios: ScenarioList,
        folder: RunFolder,
        start: float,
        look: Look | None,
    ) -> None:
        self.config, self.progress, self.backend = config, progress, backend
        self.shown = showing(backend, config.protocol)
        self.scenarios, self.folder, self.start, self.look = scenarios, folder, start, look
        self.plan = Plan(scenarios.scenarios[: config.episodes], config.task, config.protocol)
        self.ledger = Ledger(folder.records, folder.segment)
        self.seconds = dict.fromkeys(PHASES, 0.0)
        self.own_cache = folder.path / ".observations"
        self._told = ""
        everything = range(config.episodes)
        self.mine = everything if config.shard is None else config.shard.indices(config.episodes, config.batch_size)

    def go(self) -> EvaluationResult:
        done = self._finished()
        if done:
            self.progress.note(f"resumed at {done:,}/{self.config.episodes:,}")
        failed: PolicyFailureError | None = None
        audit: dict[str, Any] | None = None
        try:
            try:
                for step in self.plan.steps:
                    self._step(step)
                check_faults(self.ledger, self.scenarios.scenarios)
            except PolicyFailureError as error:
                failed = error
                if self.folder.policy_log.exists():
                    failed.hint += f"\nwhat it printed is in {self.folder.policy_log}"
            tables = write_tables(self.folder, self.plan, self.scenarios, self.ledger)
            if failed is None and self.config.audit_share:
                with self._timed("audit"):
                    audit = self._audit(seed_of(tables.files[ACTIONS_FILE]))
        finally:
            self.ledger.close()
            self.seconds["total"] = time.perf_counter() - self.start
            rounded = {phase: round(seconds, 3) for phase, seconds in self.seconds.items()}
            self.folder.note_segment(seconds=rounded, finished=self._finished() - done)
        stopped_early = None if self.look is None else self.look(tables.results)
        summary = seal_run(self.folder, self.plan, self.ledger, tables, audit, stopped_early)
        if failed is None:
            remember_run(self.folder, self.plan, self.ledger, tables, self.backend)
        shutil.rmtree(self.own_cache, ignore_errors=True)
        if failed is not None:
            raise failed
        check_infrastructure(self.ledger, summary, self.folder.path)
        return EvaluationResult(self.folder.path, summary)

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

    @cached_property
    def _workers(self) -> int:
        return worker_count(self.config.engine, self.config.workers, address=self.config.address)

    def _begin(self) -> None:
        config = self.config
        self.folder.begin_segment(
            engine=config.engine,
            workers=self._workers,
            batch_size=config.batch_size,
            order=config.order,
            shard=None if config.shard is None else str(config.shard),
        )

    def _step(self, step: int) -> None:
        alive = {index: one for index, one in self.plan.alive(step, self.ledger).items() if index in self.mine}
        if any((index, step) not in self.ledger.answers for index in alive):
            self._ask(step, alive)
        jobs = pending_jobs(alive, step, self.ledger)
        if jobs:
            self._begin()
            self.progress.phase("simulate", len(jobs))
            with self._timed("simulate"):
                simulate_jobs(
                    jobs,
                    {job.key: (job.key, step) for job in jobs},
                    self.ledger,
                    self.progress,
                    simulator=self.backend.simulator,
                    engine=self.config.engine,
                    workers=self.config.workers,
                    order=self.config.order,
                    address=self.config.address,
                )

    def _ask(self, step: int, alive: dict[int, Situation]) -> None:
        config, backend = self.config, self.shown
        wanted = [
            batch
            for batch in batches(alive, config.batch_size)
            if any((index, step) not in self.ledger.answers for index in batch.indices)
        ]
        wanted = shuffled(wanted, self.folder.salt)
        if config.order == "reverse":
            wanted.reverse()
        # Situations of later end-to-end steps come from the policy's own picks: of no use to any other run.
        shared = step == 0 or not self.plan.end_to_end
        root = rema_home() / "observations" if shared else self.own_cache
        cache = ObservationCache(root, backend.observe, backend.observation_hash)
        # Started before anything is observed: a policy that cannot be loaded is reported at once.
        with ExitStack() as stack:
            with self._timed("infer"):
                policy = stack.enter_context(self._open_policy())
            with self._timed("observe"):
                observe_batches(cache, wanted, self.progress)
            with self._timed("infer"):
                self._begin()
                self._note_policy(policy)
                infer_batches(policy, backend, cache, wanted, self.ledger, self.scenarios.scenarios, self.progress)

    def _open_policy(self) -> AbstractContextManager[PolicyProcess]:
        config = self.config
        log = self.folder.policy_log
        return self.backend.open_policy(config.policy, config.checkpoint, config.device, log, config.sandbox)

    def _note_policy(self, policy: PolicyProcess) -> None:
        check_digest(policy, self.config.policy.name, self.folder.header["identity"]["policy_digest"])
        for tag in TAGS:
            found, known = getattr(policy, tag, False), self.folder.header["policy"].get(tag)
            if known not in (None, found):
                raise SubmissionError(
                    f"policy {self.config.policy.name} has `{tag}` {found}, earlier in this run it had {known}",
                    hint=f"make `{tag}` a constant of its class, and evaluate it into a new folder (--output)",
                    policy=self.config.policy.name,
                )
            self.folder.set_policy(**{tag: found})
        isolation = getattr(policy, "isolation", None)
        if isolation is not None and str(isolation) != self._told:
            self._told = str(isolation)  # it is started more than once
            self.progress.note(f"policy sandbox: {isolation}")
        level = None if isolation is None else isolation.to_dict()
        self.folder.note_segment(isolation=level, device=self.config.device)

    def _audit(self, seed: bytes) -> dict[str, Any]:
        """Repeat what was not repeated yet, and compare."""
        config, backend = self.config, self.backend
        wanted = repeats(self.plan, self.ledger, config.audit_share, seed)
        with closing(Ledger(self.folder.repeats, self.folder.segment)) as again:
            unasked = sum((repeat.index, repeat.step) not in again.answers for repeat in wanted)
            jobs = jobs_again(wanted, self.ledger, again)
            if unasked or jobs:
                self.progress.phase("audit", unasked + len(jobs))
                self._begin()
            if unasked:
                with self._open_policy() as policy:
                    self._note_policy(policy)
                    for count in ask_again(policy, self.shown, wanted, config.batch_size, again):
                        self.progress.advance(count)
            if jobs:
                simulate_jobs(
                    jobs,
                    {job.key: (wanted[job.key].index, wanted[job.key].step) for job in jobs},
                    again,
                    self.progress,
                    simulator=backend.simulator,
                    engine="process",
                    workers=min(config.workers or default_workers(), default_workers()),  # here, whatever the engine
                    order="forward",
                )
            return audit_summary(wanted, self.ledger, again)
