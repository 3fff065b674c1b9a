"""The manifest of a release: what it is, every file with its size and sha256, and where it came from.

The sha256 of the manifest's bytes is the identity of the release: two releases with one identity are equal to the last
byte. A block may lie in the folder of an earlier release (its ``holder``): it is stored and downloaded once.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from rema_data.errors import InputError, IntegrityError, RemaError
from rema_data.heights import HEIGHT_ERROR_M, HEIGHT_OFFSET_M, MISSING
from rema_data.release.fields import check_day, check_order, check_path, record
from rema_data.schema import HEIGHT_STEP_M, SCHEMA_VERSION, TASK_NUMBERS, TASKS
from rema_data.store.columns import check_version
from rema_data.store.keys import BlockKey

__all__ = ["FORMAT", "MANIFEST", "BlockEntry", "FileEntry", "Manifest", "Parent", "check_name", "parse_manifest"]

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

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_SHA = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of a release.

    Attributes
    ----------
    path : str
        Inside the folder of its holder, with forward slashes.
    bytes : int
    sha256 : str
    holder : str
        Name of the release in whose folder the file lies.
    """

    path: str
    bytes: int
    sha256: str
    holder: str

    @property
    def location(self) -> str:
        """Path below a folder of releases, and below a mirror's URL."""
        return f"{self.holder}/{self.path}"

    @property
    def block(self) -> str | None:
        """Path of the block that the file belongs to, or None for one of the whole release."""
        parts = self.path.split("/")
        return "/".join(parts[:3]) if parts[0].startswith("round-") and len(parts) > 3 else None


@dataclass(frozen=True, slots=True)
class BlockEntry:
    """What a block holds.

    Attributes
    ----------
    round : int
    task, split : str
    episodes, steps : int
    end_effectors : int
        Different end-effector maps.
    positives : int
        Episodes that succeeded.
    policies : tuple of str
        Behaviour policy of every step of the task, in order.
    holder : str
        Release in whose folder the block lies.
    """

    round: int
    task: str
    split: str
    episodes: int
    steps: int
    end_effectors: int
    positives: int
    policies: tuple[str, ...]
    holder: str

    @property
    def key(self) -> BlockKey:
        """Which block it is."""
        return BlockKey(self.round, self.task, self.split)


@dataclass(frozen=True, slots=True)
class Parent:
    """The release that this one continues."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """A release, whole.

    Attributes
    ----------
    name : str
    title, description, license, citation : str
    blocks : tuple of BlockEntry
    files : tuple of FileEntry
        Sorted by location.
    fingerprint : dict of str to str
        Of the simulator that made it.
    plan_sha256 : str
        Of the collection plan.
    parent : Parent or None
    sources : tuple of str
        URLs of folders of releases, in the order in which they are tried.
    published : str
        Day of publication as YYYY-MM-DD, or empty.
    schema_version : int
    """

    name: str
    title: str
    description: str
    license: str
    citation: str
    blocks: tuple[BlockEntry, ...]
    files: tuple[FileEntry, ...]
    fingerprint: Mapping[str, str] = field(default_factory=dict)
    plan_sha256: str = ""
    parent: Parent | None = None
    sources: tuple[str, ...] = ()
    published: str = ""
    schema_version: int = SCHEMA_VERSION

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
        rounds: Iterable[int] | None = None,
        split: str | None = None,
    ) -> tuple[BlockEntry, ...]:
        """Blocks of some tasks, rounds and one split; None means all.

        Raises
        ------
        InputError
            The release has no such task, round or split, or no block of that combination.
        """
        wanted = {
            "task": None if tasks is None else set(_names(tasks)),
            "round": None if rounds is None else set(rounds),
            "split": None if split is None else {split},
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


def _names(tasks: Iterable[str]) -> tuple[str, ...]:
    return (tasks,) if isinstance(tasks, str) else tuple(tasks)


def check_name(name: str) -> str:
    """``name`` itself, or an InputError where it cannot name a release (and so a folder)."""
    if not _NAME.fullmatch(name) or ".." in name:
        raise InputError(
            f"{name!r} cannot name a release",
            hint="use lower-case letters, digits, dots, dashes and underscores, such as rema-mini",
            name=name,
        )
    return name


def parse_manifest(data: bytes, where: str, sha256: str | None = None, hint: str = "") -> Manifest:
    """A manifest from its bytes.

    Parameters
    ----------
    data : bytes
    where : str
        File or URL, for messages.
    sha256 : str, optional
        What the bytes must hash to.
    hint : str
        The command that brings the right bytes back, where the caller knows it.

    Raises
    ------
    IntegrityError
        They are not what ``sha256`` names, not a manifest, name a path outside the release, or contradict themselves.
    InputError
        The schema version is not one that this version of rema can read.
    """
    got = hashlib.sha256(data).hexdigest()
    if sha256 is not None and got != sha256:
        raise IntegrityError(
            f"manifest {where} has sha256 {got}, expected {sha256}",
            hint=hint or _again(where),
            expected=sha256,
            got=got,
        )
    try:
        content = json.loads(data)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError("it does not say that it is a rema release")
        check_version(content["schema_version"], where)
        manifest = _checked(content)
        if manifest.to_bytes() != data:
            raise ValueError("it is not in canonical form, or its counts do not add up")
    except RemaError as error:
        if isinstance(error, InputError) and "schema_version" in error.facts:
            raise
        raise _broken(where, error.message, hint) from error
    except KeyError as error:
        raise _broken(where, f"the field {error.args[0]} is missing", hint) from error
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise _broken(where, str(error), hint) from error
    return manifest


def _again(where: str) -> str:
    return f"copy {where} again from where it came from"


def _broken(where: str, why: str, hint: str) -> IntegrityError:
    return IntegrityError(f"manifest {where} cannot be used: {why}", hint=hint or _again(where), where=where)


def _checked(content: dict[str, Any]) -> Manifest:
    """A manifest from JSON, or a ValueError, KeyError or TypeError that says what is wrong."""
    blocks = tuple(record(BlockEntry, row) for row in content["blocks"])
    files = tuple(record(FileEntry, row) for row in content["files"])
    parent = None if content["parent"] is None else record(Parent, content["parent"])
    texts = {name: content[name] for name in ("name", "title", "description", "license", "citation", "plan_sha256")}
    for name, text in texts.items():
        if not isinstance(text, str):
            raise ValueError(f"{name} is {text!r}")
    check_name(texts["name"])
    texts["published"] = content.get("published", "")
    check_day(texts["published"])
    for name in {file.holder for file in files} | {block.holder for block in blocks}:
        check_name(name)
    if parent is not None:
        check_name(parent.name)
        if not _SHA.fullmatch(parent.sha256):
            raise ValueError(f"the parent {parent.name} has the sha256 {parent.sha256!r}")
    for file in files:
        check_path(file.path)
        if not _SHA.fullmatch(file.sha256):
            raise ValueError(f"{file.path} has the sha256 {file.sha256!r}")
    repeated = [name for name, times in Counter(file.location for file in files).items() if times > 1]
    if repeated:
        raise ValueError(f"{repeated[0]} is listed twice")
    holders = {block.key.path: block.holder for block in blocks}
    if len(holders) != len(blocks):
        raise ValueError("a block is listed twice")
    for block in blocks:
        BlockKey.parse(block.key.path)
        if len(block.policies) != len(TASKS[block.task]):
            raise ValueError(f"{block.key.path} does not name a policy for each step of {block.task}")
    for file in files:
        holder = texts["name"] if file.block is None else holders.get(file.block)
        if file.holder != holder:
            raise ValueError(f"{file.path} does not lie where its block does")
    if {file.block for file in files} - {None} != set(holders):
        raise ValueError("a block has no files")
    check_order("blocks", [(block.round, TASK_NUMBERS[block.task], block.split) for block in blocks])
    check_order("files", [file.location for file in files])
    if content["heights"] != ENCODING:
        raise ValueError(f"heights are stored in an unknown way: {content['heights']}")
    fingerprint = content["fingerprint"]
    sources = content["sources"]
    if not all(isinstance(part, str) for part in (*fingerprint, *fingerprint.values(), *sources)):
        raise ValueError("fingerprint and sources must be text")
    return Manifest(
        **texts,
        blocks=blocks,
        files=files,
        fingerprint=fingerprint,
        parent=parent,
        sources=tuple(sources),
        schema_version=content["schema_version"],
    )
