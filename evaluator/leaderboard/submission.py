"""From a finished run to an entry of the leaderboard: every check, and what it found."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.leaderboard.eligibility import obstacles
from evaluator.leaderboard.published import published_table
from evaluator.leaderboard.row import TAGS
from evaluator.policy.named import is_reserved
from evaluator.protocol import ACTION_FLIP_LIMIT
from evaluator.run.counts import same_numbers
from evaluator.run.entry import Entry, check_link, check_name
from evaluator.run.header import isolation_level
from evaluator.run.scored import ScoredRun, acting_steps, read_run
from evaluator.scenarios import VERSION
from rema_data.errors import IntegrityError, SubmissionError

if TYPE_CHECKING:
    from evaluator.run.check import Evidence

__all__ = ["Check", "check_run", "make_entry"]

_RANKING = (
    ("split", "test"),
    ("stopped_early", "false"),
    ("scenarios_hash", "that of the installed list"),
    ("episodes", "the full list"),
    ("protocol_hash", "that of this version"),
    ("unfinished", "0"),
    ("infra_errors", "within the limit"),
    ("nondeterministic", "0"),
    ("audit", "repeats, and no outcome that flipped"),
    ("actions", f"at most {ACTION_FLIP_LIMIT:.0%} of the repeated questions answered otherwise"),
)
_DIGESTS = ("policy_digest", "protocol_hash", "scenarios_hash")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_VERSIONS = ("rema", "python", "numpy", "pybullet", "torch", "openvino")
_SHOWN = 200


@dataclass(frozen=True, slots=True)
class Check:
    """One condition of a submission.

    Attributes
    ----------
    what : str
    passed : bool
    wanted, found : str
    """

    what: str
    passed: bool
    wanted: str
    found: str


def check_run(folder: Path) -> list[Check]:
    """Every condition that a run must meet to become an entry, and whether it does.

    Parameters
    ----------
    folder : Path
        Run folder of `rema evaluate`.

    Raises
    ------
    MissingFileError, InputError, IntegrityError
        The folder holds no finished and sealed run, or its ``run.json`` or ``summary.json`` is none.
    """
    return _inspect(folder)[0]


def make_entry(folder: Path, name: str = "", link: str = "") -> Entry:
    """The entry of a run that meets every condition.

    Parameters
    ----------
    folder : Path
    name : str
        How the policy is called on the board; its name in the run by default.
    link : str
        Where to read about it.

    Raises
    ------
    MissingFileError, InputError, IntegrityError
        See ``check_run``; the name or the link cannot be used.
    SubmissionError
        A condition is not met; the message says which, what was wanted, and what was found.
    """
    checks, evidence, run = _inspect(folder)
    failed = [check for check in checks if not check.passed]
    if failed or run is None:
        lines = "".join(f"\n  {check.what}: {check.found}; must be {check.wanted}" for check in failed)
        raise SubmissionError(
            f"{folder} cannot be submitted:{lines}",
            hint="see docs/submit.md for what a run must be",
            path=str(folder),
            failed=[check.what for check in failed],
        )
    shown = check_name(name or run.policy)
    own = is_reserved(shown)
    if (own and shown != run.policy) or (not own and shown in {*published_table()["success_percent"], *TAGS}):
        raise SubmissionError(
            f"{shown!r} is the name of a built-in policy, a published one or a kind of policy, "
            f"the run is of {run.policy!r}",
            hint="choose another name with --name",
            name=shown,
        )
    run = dataclasses.replace(run, policy=shown, link=check_link(link))
    return Entry(run, _provenance(evidence.header), evidence.seal["merkle_root"], evidence.seal["sha256"])


def _inspect(folder: Path) -> tuple[list[Check], Evidence, ScoredRun | None]:
    """The checks of a run, what lies in its folder, and the run; None where its tables cannot be believed."""
    from evaluator.run.check import read_evidence

    evidence = read_evidence(folder)
    findings = [f"{part.file} {part.where} {part.detail}".replace("  ", " ") for part in evidence.findings]
    checks = [Check("seal", not findings, "whole", "; ".join(findings)[:_SHOWN] or "ok")]
    try:
        run = read_run(folder)
    except IntegrityError as error:
        return [*checks, Check("episodes.parquet", False, "what summary.json says", error.message)], evidence, None
    return [*checks, *_checks(run, evidence)], evidence, run


def _checks(run: ScoredRun, evidence: Evidence) -> Iterator[Check]:
    blocking = {obstacle.what: obstacle for obstacle in obstacles(run)}
    for what, wanted in _RANKING:
        obstacle = blocking.get(what)
        yield Check(
            what, obstacle is None, obstacle.wanted if obstacle else wanted, obstacle.found if obstacle else "ok"
        )
    yield from _identity(run, evidence.header)
    yield from _statistics(run, evidence)


def _identity(run: ScoredRun, header: Mapping[str, Any]) -> Iterator[Check]:
    """Digests are there, and both files speak of one run."""
    identity, policy = _part(header, "identity"), _part(header, "policy")
    for name in _DIGESTS:
        noted = str(identity.get(name, ""))
        yield Check(f"run.json {name}", bool(_SHA256.fullmatch(noted)), "a sha256", noted[:_SHOWN] or "missing")
    said = {name: getattr(run.marks, name) for name in (*_DIGESTS, "fingerprint")}
    said |= {name: getattr(run, name) for name in ("task", "split", "protocol")}
    noted_all = {**identity, "policy": policy.get("name"), "privileged": policy.get("privileged")}
    for name, value in {**said, "policy": run.policy, "privileged": run.privileged}.items():
        wanted = noted_all.get(name)
        same = bool(value == wanted) and wanted not in (None, "", {})
        yield Check(f"summary.json {name}", same, f"{wanted} as in run.json"[:_SHOWN], str(value)[:_SHOWN])


def _part(header: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = header.get(name)
    return part if isinstance(part, dict) else {}


def _statistics(run: ScoredRun, evidence: Evidence) -> Iterator[Check]:
    """Every number of summary.json that follows from the rows, computed again; and the rows are those of the list."""
    from evaluator.run.counts import tally

    if evidence.table is None:
        return  # the seal's check has said so
    summary = evidence.summary or {}
    for name, wanted in tally(evidence.table, acting_steps(run.task, run.protocol)).items():
        found = summary.get(name)
        yield Check(f"summary.json {name}", same_numbers(found, wanted), str(wanted)[:_SHOWN], str(found)[:_SHOWN])
    names = evidence.table["scenario"].to_pylist()
    first = f"{VERSION}/{run.task}/{run.split}/"
    wrong = next((f"row {row} is {name}" for row, name in enumerate(names) if name != f"{first}{row:05d}"), "")
    yield Check("episodes.parquet scenario", not wrong, f"{first}00000 and so on", wrong or "ok")


def _provenance(header: Mapping[str, Any]) -> dict[str, Any]:
    """Versions and machine of the last process that wrote in the run, as far as they are noted."""
    segments = header["segments"] or [{}]
    last = segments[-1]
    versions, machine = _part(last, "versions"), _part(last, "machine")
    found = {name: versions.get(name) for name in _VERSIONS}
    found |= {name: machine.get(name) for name in ("system", "architecture", "processor")}
    found |= {name: last.get(name) for name in ("commit", "dirty", "engine", "device")}
    found |= {"isolation": isolation_level(header), "segments": len(segments)}
    return {name: value if isinstance(value, str | int) else None for name, value in found.items()}
