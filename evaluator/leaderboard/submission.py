"""Submission checks: the conditions that a finished run must meet, the last of which simulates every action again."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

from evaluator.leaderboard.eligibility import Check, rank_checks
from evaluator.leaderboard.naming import name_problem
from evaluator.protocol import FLIP_LIMIT
from evaluator.replay import ReplayReport, replay
from evaluator.rollout.backend import Backend
from evaluator.run.entry_fields import Link, Name
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.run.seal import RESULTS_FILE, SUMMARY_FILE
from evaluator.scenarios import VERSION
from rema_data.errors import SubmissionError
from rema_data.progress import Progress
from rema_data.validation import validated

__all__ = ["Inspection", "inspect_run", "make_entry"]

_DIGESTS = ("policy_digest", "protocol_hash", "scenarios_hash")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_SHOWN = 200


@dataclasses.dataclass(frozen=True, eq=False)
class Inspection:
    """A run, every condition that it must meet to be submitted, and whether it does."""

    run: Run
    checks: tuple[Check, ...]

    @property
    def valid(self) -> bool:
        """Whether all conditions are met."""
        return all(check.passed for check in self.checks)


def inspect_run(
    folder: Path,
    *,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
    backend: Backend | None = None,
) -> Inspection:
    """Check a run; the folder must be sealed. Every action is simulated again where everything else is in order."""
    run = read_run(folder, with_findings=True)
    untrue = [finding for finding in run.findings if finding.file == SUMMARY_FILE and finding.where]
    changed = [finding for finding in run.findings if finding not in untrue]
    checks = [
        Check("seal", not changed, "whole", "; ".join(map(str, changed))[:_SHOWN] or "ok"),
        Check(
            SUMMARY_FILE,
            not untrue,
            "what run.json and the rows give",
            "; ".join(f"{finding.where} {finding.detail}" for finding in untrue)[:_SHOWN] or "ok",
        ),
    ]
    if run.folder.counts is not None and run.folder.summary is not None:
        checks += _checks(run)
    if all(check.passed for check in checks):
        report = replay(folder, engine=engine, workers=workers, address=address, progress=progress, backend=backend)
        checks.append(_simulated(report))
    return Inspection(run, tuple(checks))


def _simulated(report: ReplayReport) -> Check:
    found = "ok"
    if report.findings:
        named = "; ".join(map(str, report.findings))[:_SHOWN]
        found = f"{report.different_rows:,} of {report.replayed:,} rows are not: {named}"
    elif not report.verified:
        found = f"another simulator: up to {100 * report.flips_ci95[1]:.2f} % other outcomes (limit {FLIP_LIMIT:.1%})"
    return Check("simulated", report.verified, "every row is what its recorded actions give", found)


def make_entry(
    inspection: Inspection, name: str = "", link: str = "", *, simulator: bool = False, adapted: bool = False
) -> Run:
    """A run that meets every condition, as ``encode`` makes an entry of it.

    ``name`` is the policy's on the board (that of the run by default), ``link`` where to read about it; ``simulator``
    declares that the policy carries a simulator or the scenario list, ``adapted`` that it was trained on changed
    situations. Raises InputError where a text cannot be used, SubmissionError where a condition is not met or the name
    is not free.
    """
    run, folder = inspection.run, inspection.run.source
    failed = [check for check in inspection.checks if not check.passed]
    if failed:
        lines = "".join(f"\n  {check.what}: {check.found}; must be {check.required}" for check in failed)
        raise SubmissionError(
            f"{folder} cannot be submitted:{lines}",
            hint="see docs/submit.md for what a run must be",
            path=str(folder),
            failed=[check.what for check in failed],
        )
    hint = "choose another --name or --link"
    shown: str = validated(Name, name or run.policy, "--name", hint=hint)  # type: ignore[arg-type]
    run = dataclasses.replace(run, adapted=adapted or run.adapted)
    if problem := name_problem(run, shown):
        raise SubmissionError(problem, hint="choose another name with --name", name=shown)
    address: str = validated(Link, link, "--link", hint=hint)  # type: ignore[arg-type]
    kind = "simulator" if simulator else dataclasses.replace(run, policy=shown).tag  # or as its class says
    return dataclasses.replace(run, policy=shown, link=address, kind_of_policy=kind)


def _checks(run: Run) -> Iterator[Check]:
    yield from rank_checks(run)
    for name in _DIGESTS:
        noted = str(run.header["identity"][name])
        yield Check(f"run.json {name}", bool(_SHA256.fullmatch(noted)), "a sha256", noted[:_SHOWN] or "missing")
    simulator = ", ".join(f"{name} {value}" for name, value in run.provenance.fingerprint.items())
    yield Check("run.json fingerprint", bool(simulator), "that of the simulator", simulator[:_SHOWN] or "missing")
    first = f"{run.suite or VERSION}/{run.task}/{run.split}/"
    names = run.table["scenario"].to_pylist()
    wrong = next((f"row {row} is {name}" for row, name in enumerate(names) if name != f"{first}{row:05d}"), "")
    yield Check(f"{RESULTS_FILE} scenario", not wrong, f"{first}00000 and so on", wrong or "ok")
