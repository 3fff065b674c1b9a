"""The replay itself: read, draw rows, simulate their recorded actions, compare."""

from __future__ import annotations

import math
import secrets
from pathlib import Path
from typing import Any

import numpy as np

from evaluator.engines import InfraError, check_engine
from evaluator.engines.child import call_in_child
from evaluator.replay.report import ReplayReport
from evaluator.rollout.derive import invalid_actions, simulate_recorded, world_identity
from evaluator.run.actions import recorded_actions
from evaluator.run.check import Finding, row_name, shortened
from evaluator.run.counts import unfinished
from evaluator.run.derived import derived_of, remember
from evaluator.run.header import RUN_FILE
from evaluator.run.plan import Plan, scenario_list
from evaluator.run.reading import read_run
from evaluator.run.records import Records
from evaluator.run.run import Run
from evaluator.run.seal import ACTIONS_FILE
from evaluator.run.tables import results_table, scenario_columns
from evaluator.runner import Backend, default_backend
from evaluator.scenarios import ScenarioList
from evaluator.sim.bullet import decisive
from evaluator.statistics import clopper_pearson
from rema_data.errors import InputError, RunMismatchError
from rema_data.progress import Progress, Silent

__all__ = ["replay"]


def replay(
    folder: Path,
    *,
    fraction: float = 1.0,
    seed: int | None = None,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
    backend: Backend | None = None,
) -> ReplayReport:
    """Check a finished run: its seal, its statistics, and a share of its episodes by simulation.

    ``backend`` is the real world by default; its policy is not used. The share is drawn at random, so that nobody can
    predict which rows will be checked.
    """
    if not 0 <= fraction <= 1:
        raise InputError(f"a fraction of {fraction}", hint="give a share from 0 to 1, such as 0.02")
    check_engine(engine, workers, address)
    run = read_run(folder, with_findings=True)
    job = _Replay(run, fraction, seed, progress or Silent(), backend or default_backend())
    if not any(finding.file == RUN_FILE for finding in run.findings):
        job.check(engine, workers, address)
    return job.report()


class _Replay:
    """A replay under way: collects findings and counts."""

    def __init__(self, run: Run, fraction: float, seed: int | None, progress: Progress, backend: Backend) -> None:
        self.run, self.fraction, self.seed = run, fraction, seed
        self.progress, self.backend = progress, backend
        self.findings = list(run.findings)
        self.differences: dict[str, tuple[Any, Any]] = {}
        self.drawn: int | None = None
        self.measured = self.unfinished = self.infra_errors = 0
        self.replayed = self.lost = self.different = self.flips = 0

    def check(self, engine: str, workers: int | None, address: str | None) -> None:
        """Statistics and rows, as far as they can be read."""
        run, backend, files = self.run, self.backend, self.run.folder
        try:
            scenarios = scenario_list(run.header)
        except RunMismatchError:
            if not self.findings:
                raise
            return  # of a header that was changed
        here = call_in_child(backend.fingerprint)
        self.differences = _world_differences(run, here, backend.protocol_hash(run.task, run.protocol))
        if files.table is None or files.table.num_rows != run.header["episodes"]:
            return
        plan = Plan(scenarios.scenarios[: run.counts.episodes], run.task, run.protocol)
        self.unfinished, self.infra_errors = unfinished(plan, run.table), run.counts.infra_errors
        if files.actions is None:
            return
        if not self.differences:
            for row, step, action in invalid_actions(plan, files.actions, backend):
                where = f"{row_name(run.table, row)}, step {step}"
                self.findings.append(Finding(ACTIONS_FILE, where, f"action {action} is not a valid one"))
        records = recorded_actions(files.actions, plan.steps)
        sample = self._sample(np.flatnonzero(run.outcomes.eligible).tolist())
        drawn = Plan([plan.scenarios[row] for row in sample], run.task, run.protocol)
        simulate_recorded(
            drawn,
            records,
            backend,
            self.progress,
            phase="replay",
            engine=engine,
            workers=workers,
            address=address,
        )
        self._compare(scenarios, plan, records, set(sample))
        if self.measured == self.replayed == len(plan.scenarios) and not (self.findings or self.differences):
            found = derived_of(results_table(scenarios, self.replayed, plan.steps, records), plan.steps, here)
            remember(world_identity(backend), run.comparable, files.actions, found)

    def _sample(self, measured: list[int]) -> list[int]:
        """Rows to be simulated again, ascending."""
        self.measured = len(measured)
        count = math.ceil(self.fraction * len(measured))
        if count in (0, len(measured)):
            return measured[:count]
        self.drawn = secrets.randbits(32) if self.seed is None else self.seed
        chosen = np.random.default_rng(self.drawn).choice(len(measured), count, replace=False)
        return sorted(measured[position] for position in chosen.tolist())

    def _compare(self, scenarios: ScenarioList, plan: Plan, records: Records, sample: set[int]) -> None:
        """Every row against what it should be: scenario and action in all, outcomes in the sample."""
        table = self.run.stored  # what is newer than the run was not recorded
        expected = results_table(scenarios, table.num_rows, plan.steps, records).to_pylist()
        lost = {key[0] for key, record in records.outcomes.items() if isinstance(record.outcome, InfraError)}
        fixed = list(scenario_columns(plan.task))
        fixed += [f"step{step}_{name}" for step in plan.steps for name in ("action", "x_m", "y_m", "theta_rad")]
        self.replayed, self.lost = len(sample - lost), len(sample & lost)
        for row, (said, found) in enumerate(zip(table.to_pylist(), expected, strict=True)):
            names = [name for name in fixed if said[name] != found[name]]
            if row in sample and row not in lost:
                other = [name for name in said if said[name] != found[name]]
                self.different += bool(other)
                self.flips += said["success"] != found["success"] or said["failure"] != found["failure"]
                names = names if self.differences else other
            if names:
                name, more = names[0], f" and {len(names) - 1} more columns" if len(names) > 1 else ""
                detail = f"{name} says {shortened(said[name])}, the replay gives {shortened(found[name])}{more}"
                self.findings.append(Finding(self.run.results_path.name, row_name(table, row), detail))

    def report(self) -> ReplayReport:
        run, summary = self.run, self.run.folder.summary or {}
        return ReplayReport(
            run=str(run.source),
            policy=run.policy,
            task=run.task,
            protocol=run.protocol,
            seal=run.provenance.seal,
            episodes=run.header["episodes"],
            unfinished=self.unfinished,
            infra_errors=self.infra_errors,
            fraction=self.fraction,
            seed=self.drawn,
            replayed=self.replayed,
            lost=self.lost,
            differences=self.differences,
            different_rows=self.different,
            different_ci95=self._share(self.different),
            flips=self.flips,
            flips_ci95=clopper_pearson(self.flips, self.replayed) if self.differences else self._share(self.flips),
            audit=summary.get("audit"),
            findings=tuple(self.findings),
        )

    def _share(self, count: int) -> tuple[float, float]:
        """Interval of a share among the measured rows; a point where all of them were looked at."""
        if self.replayed and self.replayed == self.measured:
            return count / self.replayed, count / self.replayed
        return clopper_pearson(count, self.replayed)


def _world_differences(run: Run, fingerprint: dict[str, str], protocol_hash: str) -> dict[str, tuple[Any, Any]]:
    """How simulator and protocol here differ from a run's: field to (recorded, here); empty where bits must agree."""
    known, here = decisive(run.provenance.fingerprint), decisive(fingerprint)
    pairs = {name: (known.get(name), here.get(name)) for name in sorted(known.keys() | here.keys())}
    pairs["protocol_hash"] = (run.provenance.protocol_hash, protocol_hash)
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
