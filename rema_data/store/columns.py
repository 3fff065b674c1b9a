"""The columns of ``episodes.parquet`` and ``steps.parquet``: name, type, unit, frame and meaning, in one place.

To add a column: a nullable field of ``rema_data.schema.Evidence``, or a line here, with ``since`` one above
``rema_data.schema.SCHEMA_VERSION``; and raise that number. Releases of earlier versions are read as before, with the
column's default in every row. Data that do not use an ``optional`` column are stored in the version before it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from rema_data.errors import InputError
from rema_data.repair import upgrade
from rema_data.schema import SCHEMA_VERSION, Evidence

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = [
    "EPISODE_COLUMNS",
    "STEP_COLUMNS",
    "VARIATION",
    "Column",
    "arrow_schema",
    "check_version",
    "columns_at",
    "may_vary",
    "version_with",
]


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table."""

    name: str
    type: str  # Arrow type
    meaning: str
    unit: str = ""  # m, rad, N, or empty
    frame: str = ""  # world, hand or pair for a pose (see ``rema_data.schema``); else empty
    nullable: bool = False
    since: int = 1  # schema version that introduced it; above 1 the column is nullable
    default: str | float | bool | None = None  # its value in the rows of earlier versions
    optional: bool = False  # only some releases use it: the others are stored without it


def _spec(prefix: str, what: str, nullable: bool) -> Iterator[Column]:
    yield Column(f"{prefix}_shape", "string", f"shape of {what}: I, L or T", nullable=nullable)
    yield Column(f"{prefix}_length_m", "float64", f"length of the main bar of {what}", "m", nullable=nullable)
    yield Column(f"{prefix}_width_m", "float64", f"width of the bars of {what}", "m", nullable=nullable)
    yield Column(f"{prefix}_arm_m", "float64", f"extent of the cross bar of {what}, 0 for an I", "m", nullable=nullable)
    yield Column(f"{prefix}_height_m", "float64", f"height of {what}", "m", nullable=nullable)


def _pose(prefix: str, what: str, frame: str, height: bool, nullable: bool) -> Iterator[Column]:
    for axis in ("x", "y", "z") if height else ("x", "y"):
        yield Column(f"{prefix}_{axis}_m", "float64", f"{axis} of the centre of mass of {what}", "m", frame, nullable)
    yield Column(f"{prefix}_yaw_rad", "float64", f"yaw of {what}", "rad", frame, nullable)


def _tool(number: int) -> Iterator[Column]:
    prefix, what = f"tool{number}", "the tool in the left hand" if number == 0 else "the tool in the right hand"
    if number == 0:
        what = "the first tool in hand (the left one of two)"
    yield from _spec(prefix, what, nullable=True)
    yield from _pose(prefix, what, "hand", height=True, nullable=True)
    yield Column(f"{prefix}_opening_m", "float64", f"gap between the fingers that hold {what}", "m", nullable=True)


def _pinch() -> Iterator[Column]:
    what = "the object pinched between two sticks"
    yield from _spec("pinch", what, nullable=True)
    yield from _pose("pinch", what, "pair", height=True, nullable=True)
    yield Column("pinch_left_m", "float64", "distance of the left hand from the pair's origin", "m", "pair", True)
    yield Column("pinch_right_m", "float64", "distance of the right hand from the pair's origin", "m", "pair", True)


_EVIDENCE_TYPES = {"str": "string", "float": "float64", "int": "int32"}


def _evidence() -> Iterator[Column]:
    for item in fields(Evidence):
        kind, nullable, _ = str(item.type).partition(" | None")
        yield Column(item.name, _EVIDENCE_TYPES[kind], nullable=bool(nullable), **item.metadata)


_ARM, *_MEASURED = _evidence()

_PLACE = (
    Column("task", "string", "task of the episode"),
    Column("round", "int16", "collection round, from 1"),
    Column("split", "string", "train or val, drawn from separate parts of the seed space"),
    Column("episode", "int32", "position of the episode in its (round, task, split), from 0"),
)

VARIATION = "variation"
"""The column of varied episodes."""

EPISODE_COLUMNS: tuple[Column, ...] = (
    *_PLACE,
    Column("seed", "uint64", "root seed; with task, round, split and episode it keys all that was drawn"),
    Column("first_step", "int32", "row of the episode's first step in steps.parquet"),
    Column("steps", "int8", "number of executed steps: an episode ends at its first failed one"),
    Column("success", "bool", "the last step of the task was reached and succeeded"),
    Column("failure", "string", "label of the step that ended the episode, null after a success", nullable=True),
    Column("failed_step", "int8", "position of that step in the task, null after a success", nullable=True),
    Column(
        VARIATION,
        "string",
        "what is changed in the last step of the episode, as JSON; null in a clean episode",
        nullable=True,
        since=2,
        optional=True,
    ),
)
"""One row an episode."""

STEP_COLUMNS: tuple[Column, ...] = (
    *_PLACE,
    Column("step", "int8", "position of the step in its task, from 0"),
    Column("last", "bool", "the step is the last of its task: its success is the task's"),
    Column("skill", "string", "the task whose last step is of this kind; a tool pick is a grasp"),
    Column("primitive", "string", "grasp or push: the network that answers"),
    Column("embodiment", "string", "what touches the target: gripper, tool, sticks or pinched"),
    Column("policy", "string", "behaviour policy"),
    Column("policy_digest", "string", "sha256 of the policy's code and weights"),
    Column("action", "uint16", "grid index (i * 64 + j) * 16 + k"),
    Column("i", "uint8", "row of the action, grows with world y"),
    Column("j", "uint8", "column of the action, grows with world x"),
    Column("k", "uint8", "angle of the action: yaw k * 2 pi / 16"),
    Column("x_m", "float64", "x of the action", "m", "world"),
    Column("y_m", "float64", "y of the action", "m", "world"),
    Column("theta_rad", "float64", "yaw of the action", "rad", "world"),
    _ARM,
    Column("success", "bool", "the step succeeded"),
    Column("failure", "string", "why it failed, null after a success", nullable=True),
    *_MEASURED,
    *_spec("target", "the target", nullable=False),
    *_pose("target", "the target", "world", height=False, nullable=False),
    *_tool(0),
    *_tool(1),
    *_pinch(),
    Column("scene_row", "int32", "row of the scene map in maps.zarr/scene"),
    Column("ee_row", "int32", "row of the end-effector map in maps.zarr/ee_depth and maps.zarr/ee_mask"),
)
"""One row an executed step. The columns of tools and of the pinched object are null where there is none."""


def columns_at(columns: tuple[Column, ...], version: int) -> tuple[Column, ...]:
    """The columns that a table of a schema version has."""
    return tuple(column for column in columns if column.since <= version)


def may_vary(version: int) -> bool:
    """Whether tables of a schema version have the column of varied episodes; only it says whether any is varied."""
    return any(column.name == VARIATION for column in columns_at(EPISODE_COLUMNS, version))


def version_with(*optional: str) -> int:
    """The earliest schema version in which new data that use these optional columns can be stored."""
    every = (*EPISODE_COLUMNS, *STEP_COLUMNS)
    return max(column.since for column in every if not column.optional or column.name in optional)


def arrow_schema(columns: tuple[Column, ...], version: int = SCHEMA_VERSION) -> pa.Schema:
    """Arrow schema of these columns, marked with the schema version in which their table is stored."""
    import pyarrow as pa  # opening a release does not need Arrow

    fields = [pa.field(column.name, pa.type_for_alias(column.type), column.nullable) for column in columns]
    return pa.schema(fields, {"rema.schema_version": str(version)})


def check_version(version: Any, where: str) -> int:
    """The schema version that the file ``where`` states; raises InputError where this rema cannot read it."""
    if isinstance(version, np.integer):
        version = int(version)
    if isinstance(version, int) and not isinstance(version, bool) and 1 <= version <= SCHEMA_VERSION:
        return version
    raise InputError(
        f"{where} has schema version {version!r}, this rema reads {SCHEMA_VERSION} and earlier",
        hint=upgrade(),
        schema_version=version,
    )
