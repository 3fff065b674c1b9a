"""The columns of the tables: every one explained, with its unit and frame."""

from __future__ import annotations

import dataclasses

import pyarrow as pa
import pytest

from rema_data.schema import SCHEMA_VERSION, Grip, ObjectSpec, Pinch, Placement
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, Column, arrow_schema

TABLES = pytest.mark.parametrize("columns", [EPISODE_COLUMNS, STEP_COLUMNS], ids=["episodes", "steps"])
UNITS = {"_m": "m", "_rad": "rad", "_n": "N"}


@TABLES
def test_names_are_unique_and_every_column_is_explained(columns: tuple[Column, ...]) -> None:
    names = [column.name for column in columns]
    assert len(set(names)) == len(names)
    assert all(column.meaning for column in columns)
    assert all("|" not in column.meaning for column in columns)


@TABLES
def test_a_name_with_a_unit_has_that_unit(columns: tuple[Column, ...]) -> None:
    for column in columns:
        suffix = next((suffix for suffix in UNITS if column.name.endswith(suffix)), None)
        assert column.unit == ("" if suffix is None else UNITS[suffix]), column.name


def test_every_pose_has_a_frame() -> None:
    frames = {"target": "world", "tool0": "hand", "tool1": "hand", "pinch": "pair"}
    for column in STEP_COLUMNS:
        prefix, _, rest = column.name.partition("_")
        if prefix in frames and rest in {"x_m", "y_m", "z_m", "yaw_rad"}:
            assert column.frame == frames[prefix], column.name


def test_every_value_of_an_object_has_its_column() -> None:
    names = [column.name for column in STEP_COLUMNS]
    spec = [field.name for field in dataclasses.fields(ObjectSpec)]
    for prefix, kind in (("target", Placement), ("tool0", Grip), ("tool1", Grip), ("pinch", Pinch)):
        pose = [field.name for field in dataclasses.fields(kind) if field.name != "spec"]
        start = names.index(f"{prefix}_shape")
        wanted = [f"{prefix}_{name}" for name in spec + pose]
        assert sorted(names[start : start + len(wanted)]) == sorted(wanted)


@TABLES
def test_the_schema_has_the_types_of_the_columns(columns: tuple[Column, ...]) -> None:
    schema = arrow_schema(columns)
    assert schema.metadata == {b"rema.schema_version": str(SCHEMA_VERSION).encode()}
    for column in columns:
        field = schema.field(column.name)
        assert field.type == pa.type_for_alias(column.type)
        assert field.nullable == column.nullable
