"""Submission files of the leaderboard: a small sealed JSON file with the outcome of every scenario.

The seal (sha256 over the canonical form of everything else) shows damage and careless edits; it is not a signature.
What a file says about its counts is recounted from the packed outcomes, so the two cannot disagree.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field

from evaluator.protocol import acting_steps
from evaluator.run.counts import Counts
from evaluator.run.header import Protocol, Task, check_format
from evaluator.run.run import Outcomes, Provenance, Run
from evaluator.run.summary import Audit
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.schema import Failure
from rema_data.validation import record, validated

__all__ = ["Link", "Name", "encode", "find_entries", "read_entry"]

FORMAT = 1
MAX_BYTES = 10_000
"""A submission over 10,000 scenarios stays below this; a larger file is not a submission."""
_AGAIN = "get the file again, or make it again with `rema submit RUN`"


def _name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,63}", name):
        rule = "use 1 to 64 letters, digits and _.+- that begin with a letter or a digit"
        raise ValueError(f"{name!r} cannot be a policy's name: {rule}")
    return name


def _link(link: str) -> str:
    if link and not re.fullmatch(r"https?://[A-Za-z0-9._~:/?#@!$&()*+,;=%-]{1,200}", link):
        raise ValueError(f"{link!r} is not an address: give a plain https:// address")
    return link


Name = Annotated[str, AfterValidator(_name)]
"""A policy's name as the board shows it."""
Link = Annotated[str, AfterValidator(_link)]
"""The address of a policy's paper or code, or nothing."""
_Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
_Field = Annotated[str, Field(pattern="^[A-Za-z0-9_.-]{1,80}$")]


@record
class _Policy:
    name: Name
    privileged: bool
    link: Link


@record
class _Provenance:
    policy_digest: _Sha256
    protocol_hash: _Sha256
    scenarios_hash: _Sha256
    fingerprint: Annotated[dict[_Field, _Field], Field(min_length=1)]


@record
class _Evidence:
    merkle_root: _Sha256
    seal: _Sha256


@record
class _Outcomes:
    eligible: str
    success: str


@record
class _Entry:
    format: Literal[1]
    policy: _Policy
    task: Task
    split: Literal["test", "val"]
    protocol: Protocol
    counts: Counts
    marks: _Provenance
    provenance: dict[str, str | int | bool | None]
    audit: Audit
    evidence: _Evidence
    outcomes: _Outcomes
    sha256: str


def encode(run: Run) -> bytes:
    """The submission file of a run, sealed: the same bytes for the same run. An InputError if it has no audit."""
    if run.audit is None:
        raise InputError(f"{run.source} has no audit", hint="evaluate the policy again", path=str(run.source))
    mark = run.provenance
    content = {
        "format": FORMAT,
        "policy": {"name": run.policy, "privileged": run.privileged, "link": run.link},
        "task": run.task,
        "split": run.split,
        "protocol": run.protocol,
        "counts": asdict(run.counts),
        "marks": {
            "policy_digest": mark.policy_digest,
            "protocol_hash": mark.protocol_hash,
            "scenarios_hash": mark.scenarios_hash,
            "fingerprint": dict(mark.fingerprint),
        },
        "provenance": dict(mark.environment),
        "audit": asdict(run.audit),
        "evidence": {"merkle_root": mark.merkle_root, "seal": mark.seal},
        "outcomes": {"eligible": _pack(run.outcomes.eligible), "success": _pack(run.outcomes.success)},
    }
    sealed = {**content, "sha256": seal(content)}
    return (json.dumps(sealed, indent=1, ensure_ascii=True) + "\n").encode()


def seal(content: Mapping[str, Any]) -> str:
    """sha256 (hexadecimal) over the canonical JSON of an entry, its own ``sha256`` left out."""
    plain = {name: value for name, value in content.items() if name != "sha256"}
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _pack(bits: npt.NDArray[np.bool_]) -> str:
    """One bit a scenario, the first one in the highest bit, base64."""
    return base64.b64encode(np.packbits(bits).tobytes()).decode()


def _unpack(text: str, count: int) -> npt.NDArray[np.bool_]:
    data = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    if data.size != -(-count // 8):
        raise ValueError(f"{data.size} bytes of outcomes for {count} episodes")
    bits = np.unpackbits(data).astype(bool)
    if bits[count:].any():
        raise ValueError("outcomes behind the last episode")
    return bits[:count]


def read_entry(path: Path) -> Run:
    """A run from its submission file, whose seal and counts were checked.

    Raises MissingFileError, or IntegrityError: no submission, a newer format, a broken seal, or wrong counts.
    """
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint="check the path", path=str(path))
    refused = f"submission file {path} is refused"
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES} bytes")
        content = json.loads(data)
        check_format(content, FORMAT, path)
        entry = validated(_Entry, content, refused, hint=_AGAIN, error=IntegrityError)
        if entry.sha256 != seal(content):
            raise ValueError(f"its content has sha256 {seal(content)}, its seal says {entry.sha256}")
        counts, outcomes = entry.counts, _outcomes(entry)
    except IntegrityError:
        raise
    except (ValueError, RecursionError) as error:
        raise IntegrityError(f"{refused}: {error}", hint=_AGAIN, path=str(path)) from error
    return Run(
        source=path,
        policy=entry.policy.name,
        privileged=entry.policy.privileged,
        task=entry.task,
        split=entry.split,
        protocol=entry.protocol,
        provenance=Provenance(
            **asdict(entry.marks),
            environment=entry.provenance,
            merkle_root=entry.evidence.merkle_root,
            seal=entry.evidence.seal,
        ),
        audit=entry.audit,
        isolation=str(entry.provenance.get("isolation") or ""),
        link=entry.policy.link,
        packed=(counts, outcomes),
    )


def _outcomes(entry: _Entry) -> Outcomes:
    """The outcomes of a submission; a ValueError where its counts differ."""
    counts = entry.counts
    unknown = sorted(entry.counts.failures.keys() - {label.value for label in Failure})
    if unknown:
        raise ValueError(f"unknown failure labels {', '.join(unknown)}")
    if not counts.add_up(acting_steps(entry.task, entry.protocol)):
        raise ValueError("its counts do not add up")
    eligible, success = (
        _unpack(packed, counts.episodes) for packed in (entry.outcomes.eligible, entry.outcomes.success)
    )
    found = int(eligible.sum()), int((success & eligible).sum()), int(success.sum())
    if found != (counts.eligible, counts.successes, counts.successes):
        raise ValueError(
            f"its outcomes hold {found[1]} successes of {found[0]} episodes, its counts say {counts.successes} of "
            f"{counts.eligible}"
        )
    return Outcomes(eligible, success)


def find_entries() -> list[Path]:
    """The submission files that come with this installation, sorted by name."""
    return sorted((manifests_dir() / "leaderboard").glob("*.json"))
