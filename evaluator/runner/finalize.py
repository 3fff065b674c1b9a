"""Finalize a run, played here or merged from shards: its tables, its summary and its seal."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from evaluator.run.actions import actions_of, encode_actions
from evaluator.run.counts import count_rows
from evaluator.run.folder import TIMINGS_FILE, RunFolder
from evaluator.run.merkle import merkle_root
from evaluator.run.plan import Plan
from evaluator.run.records import Ledger
from evaluator.run.rows import row_leaves
from evaluator.run.seal import ACTIONS_FILE, LEAVES_FILE, RESULTS_FILE, SUMMARY_FILE
from evaluator.run.summary import summarise
from evaluator.run.tables import results_table, timings_table, to_parquet
from evaluator.scenarios import ScenarioList

__all__ = ["RunTables", "seal_run", "write_tables"]


@dataclass(frozen=True, slots=True)
class RunTables:
    """What was written: results, root of the hash tree over their rows, and sealed files by name."""

    results: pa.Table
    root: bytes
    files: dict[str, bytes]


def write_tables(folder: RunFolder, plan: Plan, scenarios: ScenarioList, ledger: Ledger) -> RunTables:
    """Write everything that follows from the records: rows, actions, leaves of the hash tree, timings."""
    table = results_table(scenarios, len(plan.scenarios), plan.steps, ledger)
    leaves = row_leaves(table)
    files = {
        RESULTS_FILE: to_parquet(table),
        ACTIONS_FILE: encode_actions(actions_of(table, plan.steps)),
        LEAVES_FILE: b"".join(leaves),
    }
    for name, content in files.items():
        folder.write(name, content)
    folder.write(TIMINGS_FILE, to_parquet(timings_table(ledger, len(plan.scenarios)), page_checksums=True))
    return RunTables(table, merkle_root(leaves), files)


def seal_run(
    folder: RunFolder,
    plan: Plan,
    ledger: Ledger,
    tables: RunTables,
    audit: dict[str, Any] | None,
    stopped_early: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Write the summary, which is returned, and put the seal over it and the tables.

    ``audit`` comes from ``audit_summary``; ``stopped_early`` says why a run without a rank stopped.
    """
    summary = summarise(
        plan, ledger, count_rows(tables.results, plan.steps), tables.results, folder.header, tables.root, audit
    )
    if stopped_early is not None:
        summary["stopped_early"] = stopped_early
    payload = (json.dumps(summary, indent=2) + "\n").encode()
    folder.write(SUMMARY_FILE, payload)
    files = {**tables.files, SUMMARY_FILE: payload}
    folder.seal(files, root=tables.root, steps=plan.steps, unfinished=summary["unfinished"])
    return summary
