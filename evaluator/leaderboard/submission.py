"""Submission checks: the conditions that a finished run must meet."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

from evaluator.leaderboard.eligibility import Check, rank_checks
from evaluator.leaderboard.published import published_table
from evaluator.leaderboard.row import TAGS
from evaluator.policy.named import is_reserved
from evaluator.run.entry import Link, Name
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.run.seal import RESULTS_FILE, SUMMARY_FILE
from evaluator.scenarios import VERSION
from rema_data.errors import SubmissionError
from rema_data.validation import validated

__all__ = ["check_run", "make_entry"]

_DIGESTS = ("policy_digest", "protocol_hash", "scenarios_hash")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_SHOWN = 200


def check_run(folder: Path) -> list[Check]:
    """Every condition that a run must meet to be submitted, and whether it does; the folder must be sealed."""
    return _inspect(folder)[0]


def make_entry(folder: Path, name: str = "", link: str = "") -> Run:
    """A run that meets every condition, as ``encode`` makes a submission file of it.

    ``name`` is the policy's on the board (that of the run by default), ``link`` where to read about it. Raises
    InputError where either cannot be used, SubmissionError where a condition is not met, and what ``read_run`` raises.
    """
    checks, run = _inspect(folder)
    failed = [check for check in checks if not check.passed]
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
    own = is_reserved(shown)
    if (own and shown != run.policy) or (not own and shown in {*published_table()["success_percent"], *TAGS}):
        raise SubmissionError(
            f"{shown!r} is the name of a built-in policy, a published one or a kind of policy, "
            f"the run is of {run.policy!r}",
            hint="choose another name with --name",
            name=shown,
        )
    address: str = validated(Link, link, "--link", hint=hint)  # type: ignore[arg-type]
    return dataclasses.replace(run, policy=shown, link=address)


def _inspect(folder: Path) -> tuple[list[Check], Run]:
    """The checks of a run, and the run; without those on its rows where they cannot be read."""
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
    return checks, run


def _checks(run: Run) -> Iterator[Check]:
    yield from rank_checks(run)
    for name in _DIGESTS:
        noted = str(run.header["identity"][name])
        yield Check(f"run.json {name}", bool(_SHA256.fullmatch(noted)), "a sha256", noted[:_SHOWN] or "missing")
    simulator = ", ".join(f"{name} {value}" for name, value in run.provenance.fingerprint.items())
    yield Check("run.json fingerprint", bool(simulator), "that of the simulator", simulator[:_SHOWN] or "missing")
    first = f"{VERSION}/{run.task}/{run.split}/"
    names = run.table["scenario"].to_pylist()
    wrong = next((f"row {row} is {name}" for row, name in enumerate(names) if name != f"{first}{row:05d}"), "")
    yield Check(f"{RESULTS_FILE} scenario", not wrong, f"{first}00000 and so on", wrong or "ok")
