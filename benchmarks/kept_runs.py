"""Summaries of whole runs that are kept in benchmarks/results/runs, for the pages that are made of them."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks.results import RESULTS
from evaluator.protocol import protocol_hash
from evaluator.scenarios import installed_list

KEPT = RESULTS / "runs"


def keep(runs: Iterable[Path]) -> None:
    """Copy the summaries of run folders."""
    KEPT.mkdir(parents=True, exist_ok=True)
    for run in runs:
        shutil.copyfile(run / "summary.json", KEPT / f"{run.name}.json")


def kept_runs() -> dict[str, dict[str, Any]]:
    """Summaries by the name of the run's folder: those over the whole test list, under the rules in force."""
    found = {}
    for path in sorted(KEPT.glob("*.json")):
        summary = json.loads(path.read_text(encoding="utf-8"))
        task, listed = summary["task"], installed_list(summary["task"], "test")
        rules = (summary["scenarios_hash"], summary["episodes"]), protocol_hash(task, summary["protocol"])
        if (listed, summary["protocol_hash"]) != rules or summary.get("unfinished") or summary.get("stopped_early"):
            print(f"left out: {path.name} is not of the test list and the protocol in force", file=sys.stderr)
            continue
        found[path.stem] = summary
    return found
