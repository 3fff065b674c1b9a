"""Frozen scenario lists: Parquet files whose sha256 stands in a manifest.

A list has one row a scenario. Its columns follow from the task: ``object{n}_*`` for the object of step n,
``tool{n}_*`` for the n-th tool in hand (0: the left hand's where there are two) and ``pinch_*`` for the pinched object.
A list of a suite has a last column ``variation``, JSON: what is other than in the clean protocol.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.parquet as pq
import pydantic
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from rema_data.bounded import MOST_ROWS, parquet_table
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.manifests import manifests_dir, read_manifest
from rema_data.repair import restore
from rema_data.schema import (
    TASKS,
    Grip,
    ObjectSpec,
    Pinch,
    Placement,
    Scenario,
    Shape,
    check_task,
    pinch_step,
    tool_steps,
)
from rema_data.storage import rema_home, write_atomic
from rema_data.validation import validated
from rema_data.variation import Variation, variation_from_text, variation_text

__all__ = [
    "ScenarioList",
    "decode_list",
    "encode_list",
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

_VARIATION = "variation"
_SPEC = tuple(field.name for field in dataclasses.fields(ObjectSpec) if field.name != "shape")
_POSE: dict[type, tuple[str, ...]] = {
    Placement: ("x_m", "y_m", "yaw_rad"),
    Grip: ("x_m", "y_m", "z_m", "yaw_rad", "opening_m"),
    Pinch: ("x_m", "y_m", "z_m", "yaw_rad", "left_m", "right_m"),
}


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


def _groups(task: str) -> dict[str, type]:
    """Prefix of the columns, and type, of every object of a row, in the order of the file."""
    groups: dict[str, type] = {f"object{step}": Placement for step in range(len(TASKS[task]))}
    groups |= {f"tool{tool}": Grip for tool in range(len(tool_steps(task)))}
    return groups | ({"pinch": Pinch} if pinch_step(task) is not None else {})


def _schema(task: str, varied: bool = False) -> pa.Schema:
    fields = [pa.field("index", pa.int32(), nullable=False)]
    for prefix, kind in _groups(task).items():
        fields.append(pa.field(f"{prefix}_shape", pa.string()))
        fields.extend(pa.field(f"{prefix}_{name}", pa.float64()) for name in _SPEC + _POSE[kind])
    if varied:
        fields.append(pa.field(_VARIATION, pa.string(), nullable=False))
    return pa.schema(fields)


def _row(scenario: Scenario) -> dict[str, Any]:
    row: dict[str, Any] = {"index": scenario.index}
    held: dict[str, Placement | Grip | Pinch | None] = {
        **{f"object{n}": placement for n, placement in enumerate(scenario.placements)},
        **{f"tool{n}": grip for n, grip in enumerate(scenario.grips)},
        "pinch": scenario.pinch,
    }
    for prefix, kind in _groups(scenario.task).items():
        thing = held.get(prefix)
        if thing is not None:
            row[f"{prefix}_shape"] = thing.spec.shape.value
            row.update({f"{prefix}_{name}": float(getattr(thing.spec, name)) for name in _SPEC})
            row.update({f"{prefix}_{name}": float(getattr(thing, name)) for name in _POSE[kind]})
    if scenario.variation is not None:
        row[_VARIATION] = variation_text(scenario.variation)
    return row


def encode_list(scenarios: Sequence[Scenario]) -> bytes:
    """Bytes of the Parquet file of a list: the same for the same scenarios on the same pyarrow.

    Raises InputError for a list that is empty, mixes tasks or splits, or whose indices do not count from 0.
    """
    if not scenarios:
        raise InputError("a scenario list needs at least one scenario", hint="generate some")
    task, split = scenarios[0].task, scenarios[0].split
    for position, scenario in enumerate(scenarios):
        if (scenario.task, scenario.split, scenario.index) != (task, split, position):
            raise InputError(
                f"scenario {position} of the {task}/{split} list says it is "
                f"{scenario.task}/{scenario.split}/{scenario.index}",
                hint="number the scenarios of one task and one split from 0",
                position=position,
            )
        if len(scenario.placements) != len(TASKS[task]):
            raise InputError(
                f"scenario {position} has {len(scenario.placements)} objects, {task} has {len(TASKS[task])} steps",
                hint="give every step its object",
                position=position,
            )
    varied = {scenario.variation is not None for scenario in scenarios}
    if len(varied) > 1:
        raise InputError(f"the {task}/{split} list mixes clean and varied scenarios", hint="write two lists")
    schema = _schema(task, *varied).with_metadata({"rema.task": task, "rema.split": split})
    buffer = io.BytesIO()
    table = pa.Table.from_pylist([_row(scenario) for scenario in scenarios], schema=schema)
    pq.write_table(table, buffer, compression="zstd", compression_level=9, version="2.6", row_group_size=len(scenarios))
    return buffer.getvalue()


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
    payload = path.read_bytes()
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
        table = parquet_table(payload, count)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise IntegrityError(
            f"scenario list {path} cannot be read: {error}", hint=restore(path), path=str(path)
        ) from error
    schema = _schema(task, _VARIATION in table.schema.names)
    if table.schema.names != schema.names or table.schema.types != schema.types:
        raise IntegrityError(
            f"scenario list {path} does not have the columns of a {task} list",
            hint="install the version of rema that the list belongs to",
            path=str(path),
        )
    if table.num_rows != count or table["index"].to_pylist() != list(range(count)):
        raise IntegrityError(
            f"scenario list {path} does not have the scenarios 0 to {count - 1}", hint=restore(path), path=str(path)
        )
    try:
        return _scenarios(table, task, split)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise IntegrityError(
            f"scenario list {path} holds a scenario that cannot be: {error}", hint=restore(path), path=str(path)
        ) from error


def decode_list(payload: bytes, count: int, task: str, split: str) -> tuple[Scenario, ...]:
    """Inverse of ``encode_list``; a ValueError, KeyError or TypeError for anything else."""
    return _scenarios(parquet_table(payload, count), task, split)


def _variation(text: str) -> Variation:
    """What a scenario of a suite changes; a ValueError, in one line, for anything else."""
    try:
        found = variation_from_text(text)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "it"
        raise ValueError(f"what it changes is not known: {where}: {first['msg']}") from error
    json.loads(text, parse_constant=_not_finite)
    return found


def _not_finite(text: str) -> float:
    raise ValueError(f"{text} is no quantity")


def _scenarios(table: pa.Table, task: str, split: str) -> tuple[Scenario, ...]:
    """The rows of a list; raises ValueError, KeyError or TypeError where one lacks a part."""
    columns = table.to_pydict()
    shapes = {shape.value: shape for shape in Shape}

    def read(prefix: str, kind: type) -> list[Any]:
        size = zip(*(columns[f"{prefix}_{name}"] for name in _SPEC), strict=True)
        pose = zip(*(columns[f"{prefix}_{name}"] for name in _POSE[kind]), strict=True)
        return [
            None if shape is None else kind(ObjectSpec(shapes[shape], *lengths), *numbers)
            for shape, lengths, numbers in zip(columns[f"{prefix}_shape"], size, pose, strict=True)
        ]

    held = {prefix: read(prefix, kind) for prefix, kind in _groups(task).items()}
    steps = len(TASKS[task])
    pinches = held.pop("pinch", [None] * table.num_rows)
    texts: list[str | None] = columns.get(_VARIATION, [None] * table.num_rows)
    variations = [None if text is None else _variation(text) for text in texts]
    rows = zip(
        columns["index"],
        zip(*held.values(), strict=True),
        pinches,
        variations,
        strict=True,
    )
    return tuple(
        Scenario(
            task,
            split,
            index,
            things[:steps],
            tuple(grip for grip in things[steps:] if grip is not None),
            pinch,
            variation,
        )
        for index, things, pinch, variation in rows
    )
