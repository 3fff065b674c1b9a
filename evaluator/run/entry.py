"""Entries of the leaderboard: a small sealed JSON file that says who solved which scenario.

The seal (sha256 over the canonical form of everything else) tells damage and careless edits; it is no signature. What
a file says about its counts is recounted from the packed outcomes, so the two cannot disagree.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.protocol import PROTOCOLS
from evaluator.run.scored import Audit, Counts, FunnelStep, Marks, Outcomes, ScoredRun, acting_steps, read_run
from evaluator.scenarios import SPLITS
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.schema import TASKS, Failure

__all__ = ["Entry", "check_link", "check_name", "encode", "find_entries", "read_entry", "read_scored"]

FORMAT = 1
MAX_BYTES = 10_000
"""An entry over 10,000 scenarios stays below this; a larger file is none."""
_FIELDS = {
    "format": int,
    "policy": dict,
    "task": str,
    "split": str,
    "protocol": str,
    "counts": dict,
    "marks": dict,
    "audit": dict,
    "provenance": dict,
    "evidence": dict,
    "outcomes": dict,
    "sha256": str,
}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,63}")
_LINK = re.compile(r"https?://[A-Za-z0-9._~:/?#@!$&()*+,;=%-]{1,200}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_FINGERPRINT = re.compile(r"[A-Za-z0-9_.-]{1,80}")


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A run ready for the leaderboard.

    Attributes
    ----------
    run : ScoredRun
        With its outcomes.
    provenance : dict
        Versions, commit and engine of the run, as strings, whole numbers, booleans or null: for people.
    merkle_root, seal : str
        Of the run folder: whoever has the folder, or a proof of one row, can check it against this entry.
    """

    run: ScoredRun
    provenance: Mapping[str, Any]
    merkle_root: str
    seal: str


def check_name(name: str) -> str:
    """A policy's name as the table shows it.

    Raises
    ------
    InputError
        It is not 1 to 64 letters, digits, ``_ . + -`` that begin with a letter or a digit.
    """
    if not _NAME.fullmatch(name):
        hint = "use 1 to 64 letters, digits and _.+- that begin with a letter or a digit"
        raise InputError(f"{name!r} cannot be a policy's name", hint=hint, name=name)
    return name


def check_link(link: str) -> str:
    """The address of a policy's paper or code, or nothing.

    Raises
    ------
    InputError
        It is no plain http(s) address of at most 200 characters.
    """
    if link and not _LINK.fullmatch(link):
        raise InputError(f"{link!r} is no address", hint="give a plain https:// address", link=link)
    return link


def encode(entry: Entry) -> bytes:
    """The file of an entry, sealed: the same bytes for the same entry.

    Raises
    ------
    InputError
        The run has no outcomes, or no audit.
    """
    run = entry.run
    if run.outcomes is None or run.audit is None:
        lacking = "outcomes" if run.outcomes is None else "audit"
        raise InputError(f"{run.source} has no {lacking}", hint="evaluate the policy again", path=str(run.source))
    content = {
        "format": FORMAT,
        "policy": {"name": run.policy, "privileged": run.privileged, "link": run.link},
        "task": run.task,
        "split": run.split,
        "protocol": run.protocol,
        "counts": asdict(run.counts),
        "marks": {**asdict(run.marks), "fingerprint": dict(run.marks.fingerprint or {})},
        "provenance": dict(entry.provenance),
        "audit": asdict(run.audit),
        "evidence": {"merkle_root": entry.merkle_root, "seal": entry.seal},
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


def read_entry(path: Path) -> Entry:
    """An entry whose seal and counts were checked.

    Raises
    ------
    MissingFileError
        There is no such file.
    IntegrityError
        It is no entry of this version, its seal is broken, or its counts are not those of its outcomes.
    """
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint="check the path", path=str(path))
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES} bytes")
        content = json.loads(data)
        _check_shape(content)
        if content["sha256"] != seal(content):
            raise ValueError(f"its content has sha256 {seal(content)}, its seal says {content['sha256']}")
        return _entry(content, path)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, binascii.Error) as error:
        hint = "get the file again, or make it anew with `rema submit RUN`"
        raise IntegrityError(f"leaderboard entry {path} is refused: {error}", hint=hint, path=str(path)) from error


def _check_shape(content: Any) -> None:
    if not isinstance(content, dict):
        raise ValueError("it is no JSON object")
    if content.get("format") != FORMAT:
        raise ValueError(f"format {content.get('format')!r}, this version reads {FORMAT}")
    if set(content) != set(_FIELDS):
        raise ValueError(f"fields {', '.join(sorted(set(content) ^ set(_FIELDS)))} are missing or unknown")
    for name, kind in _FIELDS.items():
        if type(content[name]) is not kind:
            raise ValueError(f"{name} is no {kind.__name__}")
    if content["task"] not in TASKS or content["protocol"] not in PROTOCOLS or content["split"] not in SPLITS:
        raise ValueError(f"task {content['task']!r}, protocol {content['protocol']!r}, split {content['split']!r}")


def _entry(content: dict[str, Any], path: Path) -> Entry:
    policy, marks, task, protocol = content["policy"], content["marks"], content["task"], content["protocol"]
    if set(policy) != {"name", "privileged", "link"} or type(policy["privileged"]) is not bool:
        raise ValueError("policy is not a name, a link and whether it is privileged")
    counts = _counts(content["counts"], task, protocol)
    eligible, success = (_unpack(content["outcomes"][name], counts.episodes) for name in ("eligible", "success"))
    outcomes = Outcomes(np.ones(counts.episodes, bool), eligible, success)
    held = (
        int(outcomes.eligible.sum()),
        int((outcomes.success & outcomes.eligible).sum()),
        int(outcomes.success.sum()),
    )
    if held != (counts.eligible, counts.successes, counts.successes):
        raise ValueError(
            f"its outcomes hold {held[1]} successes of {held[0]} episodes, its counts say {counts.successes} of "
            f"{counts.eligible}"
        )
    seals = Marks(marks["policy_digest"], marks["protocol_hash"], marks["scenarios_hash"], marks["fingerprint"])
    evidence = content["evidence"]["merkle_root"], content["evidence"]["seal"]
    for name in (seals.policy_digest, seals.protocol_hash, seals.scenarios_hash, *evidence):
        if not _SHA256.fullmatch(name):
            raise ValueError(f"{name[:80]!r} is no sha256")
    fingerprint = dict(seals.fingerprint or {})
    if not fingerprint or not all(_FINGERPRINT.fullmatch(part) for item in fingerprint.items() for part in item):
        raise ValueError("its simulator fingerprint is none")
    if not all(value is None or isinstance(value, str | int) for value in content["provenance"].values()):
        raise ValueError("its provenance is not plain")
    run = ScoredRun(
        source=path,
        kind="entry",
        policy=check_name(policy["name"]),
        privileged=policy["privileged"],
        task=task,
        split=content["split"],
        protocol=protocol,
        counts=counts,
        marks=seals,
        audit=_audit(content["audit"]),
        outcomes=outcomes,
        link=check_link(policy["link"]),
        isolation=str(content["provenance"].get("isolation") or ""),
    )
    return Entry(run, content["provenance"], *evidence)


def _audit(content: dict[str, Any]) -> Audit:
    audit = Audit(**content)
    if any(type(number) is not int or number < 0 for number in content.values()):
        raise ValueError("its audit is not all whole numbers")
    if audit.action_flips > audit.actions or audit.outcome_flips > audit.outcomes:
        raise ValueError("its audit does not add up")
    return audit


def _counts(content: dict[str, Any], task: str, protocol: str) -> Counts:
    """The counts of an entry, of which every sum adds up."""
    funnel = tuple(FunnelStep(**step) for step in content["funnel"])
    counts = Counts(**{**content, "funnel": funnel})
    single = (counts.episodes, counts.eligible, counts.successes, counts.policy_errors, counts.infra_errors)
    numbers = [*single, *counts.failures.values()]
    numbers += [number for step in funnel for number in (step.step, step.attempted, step.succeeded)]
    if any(type(number) is not int or number < 0 for number in numbers) or counts.episodes == 0:
        raise ValueError("its counts are not all whole numbers")
    if not set(counts.failures) <= {label.value for label in Failure}:
        raise ValueError(f"failure labels {', '.join(sorted(counts.failures))}")
    if (
        counts.eligible + counts.infra_errors > counts.episodes
        or counts.successes + sum(counts.failures.values()) != counts.eligible
        or counts.policy_errors != counts.failures.get(Failure.POLICY_ERROR.value, 0)
        or tuple(step.step for step in funnel) != acting_steps(task, protocol)
        or any(step.succeeded > step.attempted for step in funnel)
        or funnel[-1].succeeded != counts.successes
    ):
        raise ValueError("its counts do not add up")
    return counts


def find_entries() -> list[Path]:
    """The entries that come with this installation, sorted by name."""
    return sorted((manifests_dir() / "leaderboard").glob("*.json"))


def read_scored(path: Path) -> ScoredRun:
    """A run from its folder, or from its entry.

    Raises
    ------
    MissingFileError, InputError, IntegrityError
        See ``read_run`` and ``read_entry``.
    """
    return read_entry(path).run if path.is_file() else read_run(path)
