"""``run.json``: read, checked for its shape, and written as the same bytes for the same content."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NotRequired

import pydantic
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from evaluator.policy.loading import NAME_LENGTH
from evaluator.policy.named import policy_names
from evaluator.protocol import BLANKED, PROTOCOLS
from evaluator.run.audit import AuditNumbers
from evaluator.scenarios.lists import FRESH, version_of
from evaluator.scenarios.seeds import count_of, seed_of
from evaluator.scenarios.suites import suites
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.schema import TASKS
from rema_data.storage import storage_errors
from rema_data.validation import validated

__all__ = [
    "RUN_FILE",
    "RUN_FORMAT",
    "Protocol",
    "Sha256",
    "Task",
    "check_format",
    "encode_header",
    "environment_of",
    "isolation_level",
    "read_header",
    "resume_command",
]

RUN_FILE = "run.json"
RUN_FORMAT = 3
"""1: the table of a run is called episodes.parquet, and a rate of 0 or 1 has Wilson's interval. 2: results.parquet, and
the interval that the tables show. 3: the seal is one sha256, and ``end`` has what ``summary.json`` had alone."""
_RESTORE = "restore it from a copy, or evaluate the policy into another folder with --output"
_VERSIONS = ("rema", "python", "numpy", "pybullet", "torch", "openvino")


def _task(name: str) -> str:
    if name not in TASKS:
        raise ValueError(f"unknown task {name!r}")
    return name


def _protocol(name: str) -> str:
    if name not in PROTOCOLS and name not in BLANKED:
        raise ValueError(f"unknown protocol {name!r}")
    return name


def _policy_name(name: str) -> str:
    if not name or len(name) > NAME_LENGTH or not name.isprintable():
        raise ValueError(f"{name[:NAME_LENGTH]!r} cannot be a policy name")
    return name


Task = Annotated[str, pydantic.AfterValidator(_task)]
Protocol = Annotated[str, pydantic.AfterValidator(_protocol)]
Sha256 = Annotated[str, pydantic.Field(pattern="^[0-9a-f]{64}$")]
_CLOSED = pydantic.ConfigDict(extra="forbid", strict=True)
_OPEN = pydantic.ConfigDict(extra="allow", strict=True)


@pydantic.with_config(_CLOSED)
class _Identity(TypedDict):
    task: Task
    split: str
    protocol: Protocol
    policy_digest: str
    protocol_hash: str
    scenarios_hash: str
    fingerprint: dict[str, str]


@pydantic.with_config(_CLOSED)
class _Policy(TypedDict, total=False):
    name: Annotated[str, pydantic.AfterValidator(_policy_name)]
    file: str
    class_name: str
    privileged: bool
    simulator: bool
    adapted: bool


@pydantic.with_config(_OPEN)
class _Segment(TypedDict, total=False):
    """What a process noted about itself; for people, so more may be there."""

    number: int
    machine: dict[str, Any]
    versions: dict[str, str]
    workers: int
    seconds: dict[str, float]
    finished: int


@pydantic.with_config(_CLOSED)
class _OldSeal(TypedDict):
    """Of formats 1 and 2."""

    version: int
    merkle_root: str
    steps: list[int]
    unfinished: int
    files: dict[str, str]
    parts: dict[str, str]
    sha256: str


@pydantic.with_config(_CLOSED)
class _End(TypedDict):
    """What neither rows nor segments tell, noted when the run was sealed."""

    policy_error_reasons: dict[str, pydantic.NonNegativeInt]
    nondeterministic: pydantic.NonNegativeInt
    audit: AuditNumbers | None
    stopped_early: dict[str, Any] | None


@pydantic.with_config(_CLOSED)
class _Header(TypedDict):
    format: pydantic.PositiveInt
    identity: _Identity
    policy: _Policy
    episodes: pydantic.NonNegativeInt
    salt: str
    segments: list[_Segment]
    end: NotRequired[_End]
    seal: NotRequired[Sha256 | _OldSeal]


def encode_header(header: dict[str, Any]) -> str:
    """Content of ``run.json``."""
    return json.dumps(header, indent=2) + "\n"


def read_header(folder: Path) -> tuple[dict[str, Any], bytes]:
    """Content of a run's ``run.json``, and its bytes.

    Raises MissingFileError if there is no such file, IntegrityError if it is not a run header, or one of a newer
    format.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        raise MissingFileError(
            f"{folder} holds no run: it has no {RUN_FILE}",
            hint="give the run folder of a `rema evaluate`",
            path=str(path),
        )
    with storage_errors(path):
        payload = path.read_bytes()
    try:
        header: dict[str, Any] = json.loads(payload.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise IntegrityError(f"{path} is not a run header: {error}", hint=_RESTORE, path=str(path)) from error
    check_format(header, RUN_FORMAT, path)
    validated(_Header, header, f"{path} is not a run header", hint=_RESTORE, error=IntegrityError)
    return header, payload


def check_format(content: Any, newest: int, path: Path) -> None:
    """Raise an IntegrityError that names the version of rema to install, where a file's format is above ``newest``."""
    number = content.get("format") if isinstance(content, dict) else None
    if type(number) is int and number > newest:
        try:
            versions = content["segments"][-1]["versions"] if "segments" in content else content["provenance"]
            wanted = f'"rema>={versions["rema"]}"'
        except (KeyError, IndexError, TypeError):
            wanted = "rema"
        raise IntegrityError(
            f"{path} has format {number}; this version of rema reads formats up to {newest}",
            hint=f"install the version that wrote it, or a later one: pip install --upgrade {wanted}",
            path=str(path),
            format=number,
        )


def isolation_level(header: Mapping[str, Any]) -> str | None:
    """The lowest level of isolation among the processes that asked the policy; None where one of them noted none."""
    noted = [segment["isolation"] for segment in header["segments"] if "isolation" in segment]
    levels = [one.get("level") if isinstance(one, dict) else None for one in noted]
    return min((str(level) for level in levels), default=None) if all(levels) else None


def environment_of(header: Mapping[str, Any]) -> dict[str, Any]:
    """Versions and machine of the last process that wrote in a run, as far as they are noted: plain values."""
    last = header["segments"][-1] if header["segments"] else {}
    versions, machine = last.get("versions", {}), last.get("machine", {})
    found = {name: versions.get(name) for name in _VERSIONS}
    found |= {name: machine.get(name) for name in ("system", "architecture", "processor")}
    found |= {name: last.get(name) for name in ("commit", "dirty", "engine", "device")}
    found |= {"isolation": isolation_level(header), "segments": max(1, len(header["segments"]))}
    return {name: value if isinstance(value, str | int) else None for name, value in found.items()}


def resume_command(header: dict[str, Any], folder: Path) -> str:
    """The ``rema evaluate`` that made a run, as far as ``run.json`` tells: without its checkpoint."""
    policy, identity = header["policy"], header["identity"]
    name = policy.get("name")
    if name not in policy_names():
        name = f"{policy['file']}:{policy['class_name']}" if {"file", "class_name"} <= policy.keys() else "POLICY"
    words = ["rema", "evaluate", str(name)]
    for option in ("task", "protocol", "split"):
        if option in identity:
            words += [f"--{option}", str(identity[option])]
    version = _version(identity)
    words += _list_options(version)
    devices = [segment["device"] for segment in header["segments"] if isinstance(segment.get("device"), str)]
    if devices:
        words += ["--device", devices[-1]]
    for option in ("shard", "batch_size"):
        noted = {str(segment[option]) for segment in header["segments"] if segment.get(option) is not None}
        if len(noted) == 1:  # a merged run has several shards, and continues as a whole
            words += [f"--{option.replace('_', '-')}", *noted]
    # The number of scenarios is part of the name of a fresh list, also where a quick run stopped before its end.
    episodes = count_of(version) if version.startswith(FRESH) else header["episodes"]
    words += ["--episodes", str(episodes), "--output", str(folder)]
    return shlex.join(words)


def _version(identity: Mapping[str, Any]) -> str:
    """The version of the list of a run; empty where there are no lists at all."""
    try:
        return version_of(identity["task"], identity["split"], identity["scenarios_hash"])
    except MissingFileError:
        return ""


def _list_options(version: str) -> list[str]:
    """The options that name a list, where it is not the clean one; nothing where the list is not here."""
    if version.startswith(FRESH):
        return ["--fresh", seed_of(version)]
    return ["--suite", version] if version in suites() else []
