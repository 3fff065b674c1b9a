"""Parsers of runs, of entries, and of the frozen lists."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import evaluator
from evaluator.engines.base import InfraError
from evaluator.leaderboard.published import published_table
from evaluator.run.records import Answered, Ledger, Simulated
from evaluator.runner.observation_cache import ObservationCache
from evaluator.scenarios import load_list, update_manifest, write_list
from evaluator.scenarios.suites import cells_of, suite_length
from evaluator.scenarios.table import decode_list
from evaluator.sim.observation import observation_sha256, observe
from rema_data.schema import Failure, Scenario, StepOutcome
from tests.evaluator.fakes import fake_observe, fake_scenario
from tests.evaluator.runs import MANIFESTS, solved, write_manifests, write_run
from tests.mutations.data import sha256
from tests.mutations.parser import Again, Parser

__all__ = ["PARSERS"]


def make_run(folder: Path) -> None:
    write_manifests(folder / "manifests")
    write_run(folder / "run", solved(0.5, 1, 40))


def read_run(folder: Path) -> Any:
    run = evaluator.read_run(folder / "run")
    return {"counts": run.counts, "header": run.header, "summary": run.summary, "table": run.table, "tag": run.tag}


def read_actions(folder: Path) -> Any:
    from evaluator.run.reading import read_run as read_with_findings

    run = read_with_findings(folder / "run", with_findings=True)
    if run.findings:
        raise run.refusal()
    return run.folder.actions


def unseal(folder: Path, file: Path) -> None:
    """Take the seal away, so that the content itself is read."""
    header = folder / "run" / "run.json"
    try:
        content = json.loads(header.read_bytes())
        content.pop("seal", None)
    except (ValueError, RecursionError, AttributeError):
        return
    header.write_text(json.dumps(content, indent=2) + "\n")


def make_timings(folder: Path) -> None:
    from evaluator.run.records import Records
    from evaluator.run.tables import timings_table, to_parquet

    make_run(folder)
    records = Records()
    records.add_outcomes(
        Simulated(n, 0, StepOutcome(True, None, arm="left"), n / 7, f"worker {n % 3}", 1, 1) for n in range(40)
    )
    (folder / "run" / "timings.parquet").write_bytes(to_parquet(timings_table(records, 40), page_checksums=True))


def make_journal(folder: Path) -> None:
    ledger = Ledger(folder / "records", 1)
    ledger.add_answers(Answered(n, 0, 4825 + n) if n % 5 else Answered(n, 0, None, "raised", "x") for n in range(20))
    failed = StepOutcome(False, Failure.MISSED, arm="left", lift_m=0.25, sim_steps=3)
    ledger.add_outcomes(
        Simulated(n, 0, failed if n % 3 else InfraError("died", "signal 9"), 0.5, "here", 1) for n in range(20)
    )
    ledger.close()


def read_journal(folder: Path) -> Again:
    ledger = Ledger(folder / "records", 2)
    found = {f"{kind} {key}": value for kind in ("answers", "outcomes") for key, value in getattr(ledger, kind).items()}
    return Again(found)


def make_entry(folder: Path) -> None:
    shutil.copy(sorted((MANIFESTS / "leaderboard").glob("*.json"))[0], folder / "entry.json")


def read_entry(folder: Path) -> Any:
    run = evaluator.read_run(folder / "entry.json")
    return {"counts": run.counts, "outcomes": run.outcomes, "policy": run.policy, "provenance": run.provenance}


def name_list(folder: Path, file: Path) -> None:
    """Name the hash of a forged list in its manifest."""
    if file.suffix == ".parquet":
        manifest = file.parents[2] / "manifest.json" if not (file.parent / "manifest.json").exists() else None
        manifest = manifest or file.parent / "manifest.json"
        content = json.loads(manifest.read_text())
        for entry in content["lists"].values():
            entry["sha256"] = sha256(manifest.parent / entry["file"])
        manifest.write_text(json.dumps(content, indent=2) + "\n")


SUITE = "small-v1"


def make_suite(folder: Path) -> None:
    """Two scenarios of every cell of a frozen list, and their manifest."""
    frozen, manifest = MANIFESTS / "scenarios" / "hard-v1", folder / "manifests" / "scenarios" / SUITE / "manifest.json"
    content = json.loads((frozen / "manifest.json").read_bytes())
    scenarios = decode_list((frozen / "grasp_val.parquet").read_bytes(), content["lists"]["grasp/val"]["count"], *GRASP)
    cells: dict[tuple[str, int], list[Scenario]] = {}
    for one in scenarios:
        assert one.variation is not None
        cells.setdefault((one.variation.axis, one.variation.level), []).append(one)
    few = [one for own in cells.values() for one in own[:2]]
    sha256 = write_list(manifest.with_name("grasp_val.parquet"), [replace(one, index=n) for n, one in enumerate(few)])
    manifest.write_text(json.dumps({**content, "version": SUITE, "lists": {}}, indent=2) + "\n")
    about = {"file": "grasp_val.parquet", "sha256": sha256, "count": len(few), "seed_domain": "x"}
    update_manifest(manifest, SUITE, "grasp/val", **about)  # type: ignore[arg-type]


def read_suite(folder: Path) -> Any:
    """As an evaluation does: the list, its cells, and what a policy would see."""
    listed = load_list(*GRASP, SUITE)
    seen = [observation_sha256(observe(one.last_situation())) for one in listed.scenarios]
    return {"list": listed, "length": suite_length(SUITE, *GRASP), "cells": cells_of(listed), "seen": seen}


GRASP = ("grasp", "val")
SITUATIONS = [fake_scenario("grasp", n).first_situation() for n in range(6)]


def observations(folder: Path) -> ObservationCache:
    return ObservationCache(folder / "observations", fake_observe, "code")


PARSERS = (
    Parser("header of a run", make_run, read_run, ("run/run.json",), {"run/run.json": "json"}, unseal),
    Parser("summary of a run", make_run, read_run, ("run/summary.json",), {"run/summary.json": "json"}, unseal),
    Parser(
        "results of a run", make_run, read_run, ("run/results.parquet",), {"run/results.parquet": "parquet"}, unseal
    ),
    Parser("actions of a run", make_run, read_actions, ("run/actions.bin", "run/results.parquet")),
    Parser(
        "timings of a run",
        make_timings,
        lambda folder: list(evaluator.read_run(folder / "run").timings),
        ("run/timings.parquet",),
        {"run/timings.parquet": "parquet"},
    ),
    Parser(
        "journals of a run",
        make_journal,
        read_journal,
        ("records/*.jsonl",),
        {"records/*.jsonl": "journal"},
    ),
    Parser("entry", make_entry, read_entry, ("entry.json",), {"entry.json": "json"}),
    Parser(
        "scenario list",
        lambda folder: write_manifests(folder / "manifests"),
        lambda folder: load_list("grasp_push"),
        ("manifests/scenarios/**/*",),
        {"manifests/scenarios/**/manifest.json": "json", "manifests/scenarios/**/*grasp_push*.parquet": "parquet"},
        name_list,
    ),
    Parser(
        "suite list",
        make_suite,
        read_suite,
        (f"manifests/scenarios/{SUITE}/*",),
        {
            f"manifests/scenarios/{SUITE}/manifest.json": "json",
            f"manifests/scenarios/{SUITE}/grasp_val.parquet": "variation",
        },
        name_list,
    ),
    Parser(
        "published table",
        lambda folder: write_manifests(folder / "manifests"),
        lambda folder: published_table(),
        ("manifests/published/table2.json",),
        {"manifests/published/table2.json": "json"},
        checked=False,
    ),
    Parser(
        "observation cache",
        lambda folder: bool(observations(folder).load(SITUATIONS)),
        lambda folder: observations(folder).load(SITUATIONS),
        ("observations/**/*.obs",),
    ),
)
