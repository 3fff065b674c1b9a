"""Frozen scenario lists: Parquet files (see ``table``) whose sha256 stands in a manifest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa
import pydantic
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from evaluator.scenarios.table import OtherColumnsError, decode_list, encode_list
from rema_data.bounded import MOST_ROWS
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.manifests import manifests_dir, read_manifest
from rema_data.repair import restore
from rema_data.schema import Scenario, check_task
from rema_data.storage import rema_home, write_atomic
from rema_data.validation import validated

__all__ = [
    "ScenarioList",
    "installed_list",
    "list_length",
    "load_list",
    "manifest_path",
    "scenario_id",
    "version_of",
    "versions",
    "update_manifest",
    "write_list",
]

SPLITS = ("test", "val")
FRESH = "fresh-"
"""How versions begin that were drawn on this machine from a seed (``evaluator.scenarios.fresh``)."""
VERSION = "v2"
"""The version of the lists that evaluations use; older and newer ones may lie beside it."""


@pydantic.with_config(pydantic.ConfigDict(extra="allow", strict=True))
class _Entry(TypedDict):
    """A list in the manifest."""

    file: Annotated[str, pydantic.Field(max_length=200)]  # a longer name is none on some file systems
    sha256: str
    count: Annotated[int, pydantic.Field(ge=1, le=MOST_ROWS)]


@dataclass(frozen=True, slots=True)
class ScenarioList:
    """A frozen list, with the sha256 (hex) of its Parquet file. Indices of its scenarios count from 0 without a gap."""

    task: str
    split: str
    version: str
    sha256: str
    scenarios: tuple[Scenario, ...]


def scenario_id(version: str, scenario: Scenario) -> str:
    """Name of a scenario that is unique among all lists, for example ``v2/grasp/test/00042``."""
    return f"{version}/{scenario.task}/{scenario.split}/{scenario.index:05d}"


def write_list(path: Path, scenarios: Sequence[Scenario]) -> str:
    """Write a list atomically: sha256 of the file, for ``update_manifest``. Errors as in ``encode_list``."""
    payload = encode_list(scenarios)
    write_atomic(path, payload)
    return hashlib.sha256(payload).hexdigest()


def update_manifest(
    path: Path, version: str, entry: str, *, file: str, sha256: str, count: int, seed_domain: str, **origin: Any
) -> None:
    """Add or replace one list in the manifest at ``path``; it is created where it is missing.

    ``entry`` is ``task/split``, ``file`` is relative to the manifest, ``seed_domain`` the part of the seed space that
    the scenarios were drawn from; ``origin``, more about how the list was made, is kept as it is. Raises InputError
    where the manifest is of another version.
    """
    content: dict[str, Any] = {"version": version, "lists": {}}
    if path.exists():
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != version:
            raise InputError(
                f"{path} is of version {content['version']}, not {version}",
                hint="lists are immutable: move the old manifest away before writing a new version",
                path=str(path),
            )
    content["lists"][entry] = {"file": file, "sha256": sha256, "count": count, "seed_domain": seed_domain, **origin}
    content["lists"] = dict(sorted(content["lists"].items()))
    write_atomic(path, json.dumps(content, indent=2) + "\n")


def manifest_path(version: str) -> Path:
    """Where the manifest of a version of the lists lies; that of a fresh list is below ``REMA_HOME``."""
    return _place(version.startswith(FRESH)) / version / "manifest.json"


def _place(fresh: bool) -> Path:
    return rema_home() / "scenarios" if fresh else manifests_dir() / "scenarios"


def versions() -> tuple[str, ...]:
    """The versions of the lists that are here, the one in force first, fresh ones last."""
    frozen, fresh = ({path.parent.name for path in _place(own).glob("*/manifest.json")} for own in (False, True))
    return (VERSION, *sorted(frozen - {VERSION}, reverse=True), *sorted(fresh))


def installed_list(task: str, split: str, version: str = VERSION) -> tuple[str, int] | None:
    """sha256 and number of scenarios of a frozen list of this installation; None where it has none."""
    path = manifest_path(version)
    if not path.is_file():
        return None

    def named(content: Any) -> tuple[str, int] | None:
        entry = content["lists"].get(f"{task}/{split}")
        return None if entry is None else (str(entry["sha256"]), int(entry["count"]))

    return read_manifest(path, "scenario manifest", named)


def version_of(task: str, split: str, sha256: str) -> str:
    """The version whose list has this hash; empty where it is not here."""
    return next((one for one in versions() if (installed_list(task, split, one) or ("", 0))[0] == sha256), "")


def list_length(task: str, split: str, sha256: str) -> int | None:
    """Number of scenarios of the list with this hash, of whichever version; None where it is not here."""
    found = (installed_list(task, split, version) for version in versions())
    return next((count for known, count in filter(None, found) if known == sha256), None)


def load_list(task: str, split: str = "test", version: str | None = None) -> ScenarioList:
    """The frozen list of a task, checked against its manifest.

    Parameters
    ----------
    task : str
    split : {"test", "val"}
    version : str, optional
        ``VERSION`` by default.

    Raises
    ------
    InputError
        There is no such task, split or version.
    MissingFileError
        The manifest or the list is not there.
    IntegrityError
        The file is not the one that the manifest names.
    """
    check_task(task)
    version = VERSION if version is None else version
    path = manifest_path(version)
    if not path.is_file():
        raise MissingFileError(
            f"there are no scenario lists of version {version}: {path} does not exist",
            hint=f"use a version that is there, or restore it: {restore(path.parent)}",
            path=str(path),
        )
    lists, named = read_manifest(
        path, "scenario manifest", lambda content: (dict(content["lists"]), str(content["version"]))
    )
    if named != version:
        raise IntegrityError(
            f"{path} says that it is of version {named!r:.80}, not {version}", hint=restore(path), path=str(path)
        )
    entry = lists.get(f"{task}/{split}")
    if entry is None:
        raise InputError(
            f"there is no {split!r} list of {task}",
            hint=f"the manifest has: {', '.join(lists)}",
            task=task,
            split=split,
        )
    listed = validated(_Entry, entry, f"{path}: {task}/{split}", hint=restore(path), error=IntegrityError)
    scenarios = _read(path.parent / listed["file"], listed, task, split)
    return ScenarioList(task, split, version, listed["sha256"], scenarios)


def _read(path: Path, listed: _Entry, task: str, split: str) -> tuple[Scenario, ...]:
    sha256, count = listed["sha256"], listed["count"]
    if not path.is_file():
        raise MissingFileError(f"scenario list {path} does not exist", hint=restore(path), path=str(path))
    payload = path.read_bytes()  # hashed every time, decoded once
    got = hashlib.sha256(payload).hexdigest()
    if got != sha256:
        raise IntegrityError(
            f"scenario list {path} has sha256 {got}, its manifest says {sha256}",
            hint=restore(path),
            path=str(path),
            expected=sha256,
            got=got,
        )
    try:
        return _decoded(payload, count, task, split)
    except OtherColumnsError as error:
        raise IntegrityError(
            f"scenario list {path}: {error}",
            hint="install the version of rema that the list belongs to",
            path=str(path),
        ) from error
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise IntegrityError(
            f"scenario list {path} cannot be read: {error}", hint=restore(path), path=str(path)
        ) from error


_decoded = lru_cache(maxsize=8)(decode_list)
"""A table of a suite takes seconds to decode, and a board asks for the same one for every run."""
