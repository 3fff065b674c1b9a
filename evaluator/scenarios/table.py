"""A scenario list as a table: the bytes of a Parquet file and back.

A list has one row a scenario. Its columns follow from the task: ``object{n}_*`` for the object of step n,
``tool{n}_*`` for the n-th tool in hand (0: the left hand's where there are two) and ``pinch_*`` for the pinched object.
A list of a suite has a last column ``variation``, JSON: what is other than in the clean protocol.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pydantic

from rema_data.bounded import parquet_table
from rema_data.errors import InputError
from rema_data.schema import TASKS, Grip, ObjectSpec, Pinch, Placement, Scenario, Shape, pinch_step, tool_steps
from rema_data.variation import Variation, variation_from_text, variation_text

__all__ = ["OtherColumnsError", "decode_list", "encode_list"]

_VARIATION = "variation"
_SPEC = tuple(field.name for field in dataclasses.fields(ObjectSpec) if field.name != "shape")
_POSE: dict[type, tuple[str, ...]] = {
    Placement: ("x_m", "y_m", "yaw_rad"),
    Grip: ("x_m", "y_m", "z_m", "yaw_rad", "opening_m"),
    Pinch: ("x_m", "y_m", "z_m", "yaw_rad", "left_m", "right_m"),
}


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


class OtherColumnsError(ValueError):
    """A table is no list of the task."""


def decode_list(payload: bytes, count: int, task: str, split: str) -> tuple[Scenario, ...]:
    """Inverse of ``encode_list``, for a list of so many scenarios.

    Raises OtherColumnsError; for anything else that is no list a ValueError, KeyError, TypeError or RecursionError, and
    what pyarrow raises.
    """
    table = parquet_table(payload, count)
    schema = _schema(task, _VARIATION in table.schema.names)
    if table.schema.names != schema.names or table.schema.types != schema.types:
        raise OtherColumnsError(f"it does not have the columns of a {task} list")
    if table.num_rows != count or table["index"].to_pylist() != list(range(count)):
        raise ValueError(f"it does not have the scenarios 0 to {count - 1}")
    return _scenarios(table, task, split)


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
