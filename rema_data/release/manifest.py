"""The manifest of a release: what it is, every file with its size and sha256, and where it came from.

The sha256 of the manifest's bytes is the identity of the release: two releases with one identity are equal to the last
byte. A block may lie in the folder of an earlier release (its ``holder``): it is stored and downloaded once.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from numbers import Integral
from typing import Any, SupportsIndex

from rema_data.errors import InputError, IntegrityError, RemaError
from rema_data.heights import HEIGHT_ERROR_M, HEIGHT_OFFSET_M, MISSING
from rema_data.release.entries import (
    BlockEntry,
    FileEntry,
    Parent,
    StrictRecord,
    block_order,
    check_holder,
    check_name,
)
from rema_data.repair import copy_again
from rema_data.schema import HEIGHT_STEP_M, TASKS
from rema_data.store.columns import check_version
from rema_data.store.keys import BlockKey

__all__ = [
    "FORMAT",
    "MANIFEST",
    "BlockEntry",
    "FileEntry",
    "Manifest",
    "Parent",
    "check_name",
    "parse_manifest",
]

FORMAT = "rema release"
MANIFEST = "manifest.json"
"""Name of the manifest inside a release's own folder."""
ENCODING: dict[str, float] = {
    "step_m": HEIGHT_STEP_M,
    "offset_m": HEIGHT_OFFSET_M,
    "max_error_m": HEIGHT_ERROR_M,
    "missing": MISSING,
}
"""How heights are stored; a reader of this schema version knows no other way."""


@dataclass(frozen=True)
class Manifest(StrictRecord):
    """A release, whole."""

    name: str
    title: str
    description: str
    license: str
    citation: str
    blocks: tuple[BlockEntry, ...]
    files: tuple[FileEntry, ...]  # sorted by location
    fingerprint: Mapping[str, str] = field(default_factory=dict)  # of the simulator that made it
    plan_sha256: str = ""  # of the collection plan
    parent: Parent | None = None
    sources: tuple[str, ...] = ()  # URLs of folders of releases, in the order in which they are tried
    published: str = ""  # day of publication as YYYY-MM-DD, or empty
    schema_version: int = 1  # the newest one of its tables

    def to_bytes(self) -> bytes:
        """Canonical JSON: the bytes that are hashed, stored and published."""
        content = {
            "format": FORMAT,
            "schema_version": self.schema_version,
            "name": self.name,
            "title": self.title,
            "description": self.description,
            "license": self.license,
            "citation": self.citation,
            **({"published": self.published} if self.published else {}),
            "parent": None if self.parent is None else dataclasses.asdict(self.parent),
            "sources": list(self.sources),
            "fingerprint": dict(self.fingerprint),
            "plan_sha256": self.plan_sha256,
            "heights": ENCODING,
            "counts": self.counts,
            "blocks": [dataclasses.asdict(block) for block in self.blocks],
            "files": [dataclasses.asdict(file) for file in self.files],
        }
        return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()

    @cached_property
    def sha256(self) -> str:
        """Identity of the release."""
        return hashlib.sha256(self.to_bytes()).hexdigest()

    @property
    def counts(self) -> dict[str, int]:
        """Totals: episodes, steps, end-effector maps, positives, files and bytes."""
        names = ("episodes", "steps", "end_effectors", "positives")
        totals = {name: sum(getattr(block, name) for block in self.blocks) for name in names}
        return totals | {"files": len(self.files), "bytes": sum(file.bytes for file in self.files)}

    def select(
        self,
        tasks: Iterable[str] | None = None,
        rounds: Iterable[int] | SupportsIndex | None = None,
        split: str | Iterable[str] | None = None,
    ) -> tuple[BlockEntry, ...]:
        """Blocks of some tasks, rounds and splits; None means all. InputError where there is no such block."""
        wanted: dict[str, set[Any] | None] = {
            "task": _chosen("tasks", tasks, str),
            "round": _chosen("rounds", rounds, int),
            "split": _chosen("split", split, str),
        }
        for name, values in wanted.items():
            has = {getattr(block, name) for block in self.blocks}
            missing = (values or set()) - has
            if missing:
                listed = ", ".join(map(str, sorted(has)))
                raise InputError(
                    f"release {self.name} has no {name} {', '.join(map(str, sorted(missing, key=str)))}",
                    hint=f"it has: {listed}",
                    **{name: missing},
                )
        chosen = tuple(
            block
            for block in self.blocks
            if all(values is None or getattr(block, name) in values for name, values in wanted.items())
        )
        if not chosen:
            raise InputError(
                f"release {self.name} has no block of this combination of task, round and split",
                hint=f"list what it has: rema stats {self.name}",
            )
        return chosen

    def files_of(self, blocks: Iterable[BlockEntry]) -> tuple[FileEntry, ...]:
        """Files of some blocks, and those of the whole release."""
        paths = {block.key.path for block in blocks}
        return tuple(file for file in self.files if file.block is None or file.block in paths)


def _chosen(name: str, given: Any, kind: type[str] | type[int]) -> set[Any] | None:
    """One value or several as a set; those of numpy are as good as those of Python."""
    if given is None:
        return None
    values = [given] if isinstance(given, str) or not isinstance(given, Iterable) else list(given)
    for value in values:
        if not isinstance(value, str if kind is str else Integral) or isinstance(value, bool):
            raise InputError(
                f"{name}={given!r:.80}: {value!r:.80} is not {'a name' if kind is str else 'a whole number'}",
                hint=f"give {name} as one or a list, for example "
                + ('split="train"' if name == "split" else 'tasks=["grasp"]' if kind is str else "rounds=[1, 2]"),
            )
    return set(map(kind, values))


def parse_manifest(data: bytes, where: str, sha256: str | None = None, hint: str = "") -> Manifest:
    """A manifest from its bytes; ``where`` (file or URL) and ``hint`` (the command that repairs it) go into messages.

    With its ``sha256``, it was checked when it was sealed; without, every field is checked here. Raises IntegrityError
    where the bytes have another sha256, are not a manifest, name a path outside the release, or contradict themselves,
    and InputError for a schema version that this rema cannot read.
    """
    hint = hint or copy_again(where)
    got = hashlib.sha256(data).hexdigest()
    if sha256 is not None and got != sha256:
        raise IntegrityError(
            f"manifest {where} has sha256 {got}, expected {sha256}", hint=hint, expected=sha256, got=got
        )
    unusable = f"manifest {where} cannot be used"
    try:
        content = json.loads(data)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError("it does not say that it is a rema release")
        if "schema_version" not in content:
            raise ValueError("schema_version is missing")
        check_version(content["schema_version"], where)
        names = {item.name for item in dataclasses.fields(Manifest)}
        fields = {name: value for name, value in content.items() if name in names}
        if sha256 is not None:
            return _trusted(fields)
        json.dumps(content, ensure_ascii=False).encode()  # refuses text that is not Unicode
        from rema_data.validation import validated

        manifest = validated(Manifest, fields, unusable, hint=hint, error=IntegrityError)
        _check(manifest)
        if content.get("heights") != ENCODING:
            raise ValueError(f"heights are stored in an unknown way: {content.get('heights')}")
        if manifest.to_bytes() != data:
            raise ValueError("it is not in canonical form, or its counts do not add up")
        return manifest
    except RemaError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise IntegrityError(f"{unusable}: {error}", hint=hint, where=where) from error


def _trusted(fields: dict[str, Any]) -> Manifest:
    """A manifest from JSON that was checked when it was sealed."""
    made = {
        "blocks": tuple(BlockEntry(**row | {"policies": tuple(row["policies"])}) for row in fields["blocks"]),
        "files": tuple(FileEntry(**row) for row in fields["files"]),
        "parent": None if fields["parent"] is None else Parent(**fields["parent"]),
        "sources": tuple(fields["sources"]),
    }
    return Manifest(**fields | made)


def _check(manifest: Manifest) -> None:
    """Raise ValueError where the parts of a manifest contradict each other."""
    check_holder(manifest.name)
    if manifest.published and not _is_day(manifest.published):
        raise ValueError(f"published is {manifest.published!r}, not a day such as 2026-01-31")
    for block in manifest.blocks:
        try:
            BlockKey.parse(block.key.path)
        except InputError as error:
            raise ValueError(error.message) from error
        if len(block.policies) != len(TASKS[block.task]):
            raise ValueError(f"{block.key.path} does not name a policy for each step of {block.task}")
    for name, items in (
        ("a block", [block.key.path for block in manifest.blocks]),
        ("a file", [file.location for file in manifest.files]),
    ):
        repeated = [item for item, times in Counter(items).items() if times > 1]
        if repeated:
            raise ValueError(f"{name} is listed twice: {repeated[0]}")
    holders = {block.key.path: block.holder for block in manifest.blocks}
    for file in manifest.files:
        if file.holder != (manifest.name if file.block is None else holders.get(file.block)):
            raise ValueError(f"{file.path} does not lie where its block does")
    if {file.block for file in manifest.files} - {None} != set(holders):
        raise ValueError("a block has no files")
    if sorted(manifest.blocks, key=block_order) != list(manifest.blocks):
        raise ValueError("the blocks are not in their order")
    if sorted(manifest.files, key=lambda file: file.location) != list(manifest.files):
        raise ValueError("the files are not in their order")


def _is_day(text: str) -> bool:
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False
