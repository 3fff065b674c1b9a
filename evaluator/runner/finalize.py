"""Finalize a run, played here or merged from shards: its tables, its summary and its seal."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from evaluator.rollout.backend import Backend
from evaluator.rollout.derive import world_identity
from evaluator.run.actions import actions_of, encode_actions
from evaluator.run.counts import count_rows, unfinished
from evaluator.run.derived import derived_of, remember
from evaluator.run.folder import TIMINGS_FILE, RunFolder
from evaluator.run.plan import Plan
from evaluator.run.records import Ledger
from evaluator.run.run import COMPARABLE
from evaluator.run.seal import ACTIONS_FILE, RESULTS_FILE, SUMMARY_FILE
from evaluator.run.summary import summarise
from evaluator.run.tables import results_table, timings_table, to_parquet
from evaluator.scenarios import ScenarioList

__all__ = ["RunTables", "remember_run", "seal_run", "write_tables"]


@dataclass(frozen=True, slots=True)
class RunTables:
    """What was written: the results, and the bytes of the sealed files by name."""

    results: pa.Table
    files: dict[str, bytes]


def write_tables(folder: RunFolder, plan: Plan, scenarios: ScenarioList, ledger: Ledger) -> RunTables:
    """Write everything that follows from the records: rows, actions, timings."""
    table = results_table(scenarios, len(plan.scenarios), plan.steps, ledger)
    files = {RESULTS_FILE: to_parquet(table), ACTIONS_FILE: encode_actions(actions_of(table, plan.steps))}
    for name, content in files.items():
        folder.write(name, content)
    folder.write(TIMINGS_FILE, to_parquet(timings_table(ledger, len(plan.scenarios)), page_checksums=True))
    return RunTables(table, files)


def seal_run(
    folder: RunFolder,
    plan: Plan,
    ledger: Ledger,
    tables: RunTables,
    audit: dict[str, Any] | None,
    stopped_early: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Write the summary, which is returned, and seal the run.

    ``audit`` comes from ``audit_summary``; ``stopped_early`` says why a run without a rank stopped.
    """
    faults = Counter(str(answer.reason) for answer in ledger.answers.values() if answer.action is None)
    folder.prepare_seal(
        {
            "policy_error_reasons": dict(sorted(faults.items())),
            "nondeterministic": len(ledger.contradictions),
            "audit": audit,
            "stopped_early": stopped_early,
        }
    )
    table = tables.results
    summary = summarise(folder.header, count_rows(table, plan.steps), table, unfinished(plan, table))
    folder.write(SUMMARY_FILE, json.dumps(summary, indent=2) + "\n")
    folder.seal(tables.files)
    return summary


def remember_run(folder: RunFolder, plan: Plan, ledger: Ledger, tables: RunTables, backend: Backend) -> None:
    """Remember that this process simulated all of a run: the leaderboard need not simulate it again.

    Nothing is remembered where an outcome comes from an earlier process, or is missing.
    """
    table = tables.results
    others = any(record.segment != ledger.segment for record in ledger.outcomes.values())
    if others or unfinished(plan, table) or table.column("infra_error").null_count != table.num_rows:
        return
    identity = folder.header["identity"]
    rules = {name: identity[name] for name in COMPARABLE}
    found = derived_of(table, plan.steps, identity["fingerprint"])
    remember(world_identity(backend), rules, actions_of(table, plan.steps), found)
