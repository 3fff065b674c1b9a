"""The replay itself: read, draw rows, simulate their recorded actions, compare."""

from __future__ import annotations

import hashlib
import math
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from evaluator.engines import InfraError, check_engine
from evaluator.engines.child import call_in_child
from evaluator.replay.report import ReplayReport
from evaluator.rollout.simulate import pending_jobs, simulate_jobs
from evaluator.run.actions import NOT_ASKED, POLICY_ERROR, recorded_actions
from evaluator.run.check import Finding, row_name, shortened
from evaluator.run.counts import unfinished
from evaluator.run.header import RUN_FILE
from evaluator.run.plan import Plan, scenario_list
from evaluator.run.reading import read_run
from evaluator.run.records import Records
from evaluator.run.run import Run
from evaluator.run.seal import ACTIONS_FILE, SUMMARY_FILE
from evaluator.run.signature import SIGNATURE_FILE, is_signed_by, key_name
from evaluator.run.tables import results_table, scenario_columns
from evaluator.runner import Backend, default_backend
from evaluator.scenarios import ScenarioList
from evaluator.sim.bullet import decisive
from evaluator.statistics import clopper_pearson
from rema_data import grid
from rema_data.errors import InputError
from rema_data.progress import Progress, Silent

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

__all__ = ["replay"]


def replay(
    folder: Path,
    *,
    fraction: float = 1.0,
    seed: int | None = None,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    public_key: Ed25519PublicKey | None = None,
    progress: Progress | None = None,
    backend: Backend | None = None,
) -> ReplayReport:
    """Check a finished run: its seal, its signature, its statistics, and a share of its episodes by simulation.

    ``backend`` is the real world by default; its policy is not used. The share is drawn at random, so that nobody can
    predict which rows will be checked.
    """
    if not 0 <= fraction <= 1:
        raise InputError(f"a fraction of {fraction}", hint="give a share from 0 to 1, such as 0.02")
    check_engine(engine, workers, address)
    run = read_run(folder, with_findings=True)
    job = _Replay(run, fraction, seed, progress or Silent(), backend or default_backend())
    job.check_signature(public_key)
    if not any(finding.file == RUN_FILE for finding in run.findings):
        job.check(engine, workers, address)
    return job.report(public_key)


class _Replay:
    """A replay under way: collects findings and counts."""

    def __init__(self, run: Run, fraction: float, seed: int | None, progress: Progress, backend: Backend) -> None:
        self.run, self.fraction, self.seed = run, fraction, seed
        self.progress, self.backend = progress, backend
        self.findings = list(run.findings)
        self.signature: bytes | None = None
        self.differences: dict[str, tuple[Any, Any]] = {}
        self.drawn: int | None = None
        self.measured = self.unfinished = self.infra_errors = 0
        self.replayed = self.lost = self.different = self.flips = 0

    def check_signature(self, key: Ed25519PublicKey | None) -> None:
        path = self.run.source / SIGNATURE_FILE
        self.signature = path.read_bytes() if path.is_file() else None
        if key is None:
            return
        if self.signature is None:
            self.findings.append(Finding(SIGNATURE_FILE, "", "is missing: the run is not signed"))
        elif not is_signed_by(key, self.signature, self.run.folder.payload):
            detail = f"was not made over this {RUN_FILE} with the key {key_name(key)[:16]}"
            self.findings.append(Finding(SIGNATURE_FILE, "", detail))

    def check(self, engine: str, workers: int | None, address: str | None) -> None:
        """Statistics and rows, as far as they can be read."""
        run, backend, files = self.run, self.backend, self.run.folder
        scenarios = scenario_list(run.header)
        here = call_in_child(backend.fingerprint)
        self.differences = _world_differences(run, here, backend.protocol_hash(run.task, run.protocol))
        if files.table is None or files.table.num_rows != run.header["episodes"]:
            return
        plan = Plan(scenarios.scenarios[: run.counts.episodes], run.task, run.protocol)
        self.unfinished, self.infra_errors = unfinished(plan, run.table), run.counts.infra_errors
        if files.summary is not None and self.unfinished != run.unfinished:
            detail = f"says {run.unfinished}, {run.results_path.name} gives {self.unfinished}"
            self.findings.append(Finding(SUMMARY_FILE, "unfinished", detail))
        if files.actions is None:
            return
        if not self.differences:
            self.findings += _invalid_actions(run, files.actions, plan, backend.valid_actions)
        records = recorded_actions(files.actions, plan.steps)
        sample = self._sample(np.flatnonzero(run.outcomes.eligible).tolist())
        drawn = Plan([plan.scenarios[row] for row in sample], run.task, run.protocol)
        self._simulate(drawn, records, engine, workers, address)
        self._compare(scenarios, plan, records, set(sample))

    def _sample(self, measured: list[int]) -> list[int]:
        """Rows to be simulated again, ascending."""
        self.measured = len(measured)
        count = math.ceil(self.fraction * len(measured))
        if count in (0, len(measured)):
            return measured[:count]
        self.drawn = secrets.randbits(32) if self.seed is None else self.seed
        chosen = np.random.default_rng(self.drawn).choice(len(measured), count, replace=False)
        return sorted(measured[position] for position in chosen.tolist())

    def _simulate(self, plan: Plan, records: Records, engine: str, workers: int | None, address: str | None) -> None:
        for step in plan.steps:
            jobs = pending_jobs(plan.alive(step, records), step, records)
            if jobs:
                self.progress.phase("replay", len(jobs))
                simulate_jobs(
                    jobs,
                    {job.key: (job.key, step) for job in jobs},
                    records,
                    self.progress,
                    simulator=self.backend.simulator,
                    engine=engine,
                    workers=workers,
                    order="shuffled",
                    address=address,
                )

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

    def report(self, key: Ed25519PublicKey | None) -> ReplayReport:
        run, summary = self.run, self.run.folder.summary or {}
        return ReplayReport(
            run=str(run.source),
            policy=run.policy,
            task=run.task,
            protocol=run.protocol,
            merkle_root=run.provenance.merkle_root,
            run_sha256=hashlib.sha256(run.folder.payload).hexdigest(),
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
            flips_ci95=self._share(self.flips),
            signed=self.signature is not None,
            signer=None if key is None else key_name(key),
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


def _invalid_actions(
    run: Run,
    actions: npt.NDArray[np.uint16],
    plan: Plan,
    valid_actions: Callable[[str, int], npt.NDArray[np.bool_]],
) -> Iterator[Finding]:
    """Recorded actions that the protocol does not allow."""
    for column, step in enumerate(plan.steps):
        valid = valid_actions(plan.task, step).reshape(grid.ACTIONS)
        taken = actions[:, column]
        for row in np.flatnonzero(~valid[taken] & (taken != POLICY_ERROR) & (taken != NOT_ASKED)).tolist():
            where = f"{row_name(run.table, row)}, step {step}"
            yield Finding(ACTIONS_FILE, where, f"action {taken[row]} is not a valid one")
