"""Entries of the leaderboard: a small JSON file of what was run, and the action log. No result is in it.

Rates, labels and counts are derived from the actions, by simulation, when an entry is read. Its sha256 (over the
canonical form of everything else) shows damage and careless edits; it is not a signature.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pydantic

from evaluator.protocol import acting_steps
from evaluator.run.actions import Actions, decode_actions, encode_actions
from evaluator.run.derived import inflate
from evaluator.run.entry_fields import EntryKind, Environment, Isolation, Link, Marks, Name
from evaluator.run.header import Protocol, Sha256, Task, check_format
from evaluator.run.old_entry import read_old_entry
from evaluator.run.run import Provenance, Run
from evaluator.run.seal import canonical
from evaluator.scenarios import list_length
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.manifests import manifests_dir
from rema_data.validation import plain, record, validated

__all__ = ["MAX_BYTES", "encode", "entry_folder", "find_entries", "read_entry", "seal"]

FORMAT = 2
"""1: counts and one bit a scenario. 2: the actions, from which everything else is derived."""
MAX_BYTES = 150_000
"""An entry over 10,000 scenarios of four steps stays below this; a larger file is not an entry."""
_AGAIN = "get the file again, or make it again with `rema submit RUN`"


@record
class _Policy:
    name: Name
    kind: EntryKind
    link: Link
    adapted: bool = False  # not written where it is not


@record
class _Entry:
    format: Literal[2]
    policy: _Policy
    task: Task
    split: Literal["test"]
    protocol: Protocol
    marks: Marks
    environment: Environment
    isolation: Isolation | None
    actions: str
    sha256: Sha256


def encode(run: Run) -> bytes:
    """The entry of a run. Its environment is kept as far as it has the form of the fields; InputError if it cannot be.

    ``run.tag`` becomes the kind of the policy.
    """
    mark = run.provenance
    content = {
        "format": FORMAT,
        "policy": {"name": run.policy, "kind": run.tag, "link": run.link} | ({"adapted": True} if run.adapted else {}),
        "task": run.task,
        "split": run.split,
        "protocol": run.protocol,
        "marks": {
            "policy_digest": mark.policy_digest,
            "protocol_hash": mark.protocol_hash,
            "scenarios_hash": mark.scenarios_hash,
            "fingerprint": dict(mark.fingerprint),
        },
        "environment": plain(_environment(mark.environment)),
        "isolation": run.isolation or None,
        "actions": base64.b64encode(zlib.compress(encode_actions(run.actions), 9)).decode(),
    }
    sealed = {**content, "sha256": seal(content)}
    validated(_Entry, sealed, f"{run.source} cannot be an entry", hint="evaluate the policy again")
    return (json.dumps(sealed, indent=1, ensure_ascii=True) + "\n").encode()


def _environment(noted: Mapping[str, Any]) -> Environment:
    """What has the form of a field; anything else is left out."""
    kept: dict[str, Any] = {}
    for name in Environment.__dataclass_fields__:
        try:
            Environment(**{name: noted[name]})
        except (KeyError, pydantic.ValidationError):
            continue
        kept[name] = noted[name]
    return Environment(**kept)


def seal(content: Mapping[str, Any]) -> str:
    """sha256 (hexadecimal) over the canonical JSON of an entry, its own ``sha256`` left out."""
    return hashlib.sha256(canonical({k: v for k, v in content.items() if k != "sha256"})).hexdigest()


def read_entry(path: Path) -> Run:
    """A run from its entry, whose seal was checked. One of format 2 has no counts until they are derived.

    Raises MissingFileError, or IntegrityError: no entry, a newer format, a broken seal, or not one action for every
    step of every scenario of its list.
    """
    if not path.is_file():
        raise MissingFileError(f"{path} does not exist", hint="check the path", path=str(path))
    refused = f"entry {path} is refused"
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ValueError(f"more than {MAX_BYTES} bytes")
        content = json.loads(data)
        check_format(content, FORMAT, path)
        if not isinstance(content, dict):
            raise ValueError("it is not an object")
        old = content.get("format") == 1
        entry = None if old else validated(_Entry, content, refused, hint=_AGAIN, error=IntegrityError)
        found = read_old_entry(content, path, refused, _AGAIN) if entry is None else None
        if content["sha256"] != seal(content):
            raise ValueError(f"its content has sha256 {seal(content)}, its seal says {content['sha256']}")
        if entry is None:
            assert found is not None
            return found
        actions = _actions(entry)
    except IntegrityError:
        raise
    except (ValueError, RecursionError) as error:
        raise IntegrityError(f"{refused}: {error}", hint=_AGAIN, path=str(path)) from error
    marks = entry.marks
    return Run(
        source=path,
        policy=entry.policy.name,
        privileged=entry.policy.kind == "privileged",
        kind_of_policy=entry.policy.kind,
        task=entry.task,
        split=entry.split,
        protocol=entry.protocol,
        provenance=Provenance(
            policy_digest=marks.policy_digest,
            protocol_hash=marks.protocol_hash,
            scenarios_hash=marks.scenarios_hash,
            fingerprint=marks.fingerprint,
            environment={k: v for k, v in plain(entry.environment).items() if v is not None},
        ),
        audit=None,
        isolation=entry.isolation or "",
        link=entry.policy.link,
        adapted=entry.policy.adapted,
        digest=entry.sha256,
        recorded=actions,
    )


def _actions(entry: _Entry) -> Actions:
    """The action log; its size is known from the scenario list before anything is decompressed."""
    steps = len(acting_steps(entry.task, entry.protocol))
    count = list_length(entry.task, entry.split, entry.marks.scenarios_hash)
    if count is None:
        raise ValueError(f"its scenario list {entry.marks.scenarios_hash} is not here")
    actions = decode_actions(inflate(entry.actions, 2 * count * steps), count, steps)
    assert actions is not None
    return actions


def entry_folder() -> Path:
    """Where the entries that come with this installation lie; their verification records lie in ``verified``."""
    return manifests_dir() / "leaderboard"


def find_entries() -> list[Path]:
    """The entries that come with this installation, sorted by name."""
    return sorted(entry_folder().glob("*.json"))
