"""Recorded actions, simulated again: nothing else of a run or an entry is believed."""

from __future__ import annotations

import hashlib
import platform

import numpy as np

from evaluator.engines.child import call_in_child
from evaluator.rollout.backend import Backend
from evaluator.rollout.simulate import pending_jobs, simulate_jobs
from evaluator.run.actions import NOT_ASKED, POLICY_ERROR, Actions, recorded_actions
from evaluator.run.derived import Derived, derived_of
from evaluator.run.environment import processor_name
from evaluator.run.plan import Plan
from evaluator.run.records import Answered, Records
from evaluator.run.seal import canonical
from evaluator.run.tables import results_table
from evaluator.scenarios import ScenarioList
from evaluator.sim.bullet import bullet_version
from rema_data import grid
from rema_data.errors import InfrastructureError, IntegrityError
from rema_data.progress import Progress

__all__ = ["derive", "invalid_actions", "simulate_recorded", "world_identity"]


def world_identity(backend: Backend) -> str:
    """Identity of the simulator's code, its build and this processor: sha256, without starting a simulator."""
    parts = [backend.simulator, backend.observation_hash, bullet_version(), platform.machine(), processor_name()]
    return hashlib.sha256(canonical(parts)).hexdigest()


def invalid_actions(plan: Plan, actions: Actions, backend: Backend) -> list[tuple[int, int, int]]:
    """(row, step, action) of every recorded action that the protocol does not allow."""
    found = []
    for column, step in enumerate(plan.steps):
        valid = backend.valid_actions(plan.task, step).reshape(grid.ACTIONS)
        taken = actions[:, column]
        wrong = ~valid[taken] & (taken != POLICY_ERROR) & (taken != NOT_ASKED)
        found += [(row, step, int(taken[row])) for row in np.flatnonzero(wrong).tolist()]
    return found


def simulate_recorded(
    plan: Plan,
    records: Records,
    backend: Backend,
    progress: Progress,
    *,
    phase: str,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    missing_fails: bool = False,
) -> None:
    """Simulate the answers in ``records``, step after step; their outcomes are added.

    ``missing_fails``: an episode that reaches a step without an answer has a policy error there.
    """
    for step in plan.steps:
        alive = plan.alive(step, records)
        if missing_fails:
            absent = (index for index in alive if (index, step) not in records.answers)
            records.add_answers([Answered(index, step, None, "missing") for index in absent])
        jobs = pending_jobs(alive, step, records)
        if jobs:
            progress.phase(phase, len(jobs))
            simulate_jobs(
                jobs,
                {job.key: (job.key, step) for job in jobs},
                records,
                progress,
                simulator=backend.simulator,
                engine=engine,
                workers=workers,
                order="shuffled",
                address=address,
            )


def derive(
    scenarios: ScenarioList,
    protocol: str,
    actions: Actions,
    backend: Backend,
    progress: Progress,
    *,
    source: str,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
) -> Derived:
    """The results of the actions of the first scenarios of a list: every one is simulated.

    Raises IntegrityError (naming ``source``) where an action is not a valid one, InfrastructureError where an episode
    could not be simulated.
    """
    plan = Plan(scenarios.scenarios[: len(actions)], scenarios.task, protocol)
    if wrong := invalid_actions(plan, actions, backend):
        row, step, action = wrong[0]
        raise IntegrityError(
            f"{source} is refused: {len(wrong):,} of its actions are not valid, the first one action {action} in step "
            f"{step} of scenario {row}",
            hint="only what `rema evaluate` recorded can be an entry: run it again",
            row=row,
            step=step,
        )
    records = recorded_actions(actions, plan.steps)
    simulate_recorded(
        plan,
        records,
        backend,
        progress,
        phase="verify",
        engine=engine,
        workers=workers,
        address=address,
        missing_fails=True,
    )
    table = results_table(scenarios, len(actions), plan.steps, records)
    if lost := table.num_rows - table.column("infra_error").null_count:
        raise InfrastructureError(
            f"{lost:,} episodes of {source} could not be simulated here", hint="run the same command again", lost=lost
        )
    return derived_of(table, plan.steps, call_in_child(backend.fingerprint))
