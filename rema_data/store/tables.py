"""Records to rows and back, and the Parquet files of a block."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rema_data.bounded import MOST_ROWS, parquet_table
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.repair import RepairHint, ask_verify, upgrade
from rema_data.schema import (
    EVIDENCE,
    SCHEMA_VERSION,
    Action,
    Episode,
    Failure,
    Grip,
    ObjectSpec,
    Pinch,
    Placement,
    Shape,
    Situation,
    Step,
    StepOutcome,
    skill,
)
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, VARIATION, Column, arrow_schema, columns_at
from rema_data.variation import Variation, variation_from_text, variation_text

__all__ = [
    "as_stored",
    "checked_table",
    "complete",
    "episode_row",
    "episodes_table",
    "outcome_of",
    "read_table",
    "situation_of",
    "step_row",
    "steps_table",
    "table_version",
    "to_parquet",
    "variation_of",
    "with_column",
    "with_version",
]

_SPEC = tuple(field.name for field in dataclasses.fields(ObjectSpec))


def episode_row(episode: Episode, first_step: int) -> dict[str, Any]:
    """Row of ``episodes.parquet``."""
    failed = None if episode.success else episode.steps[-1].situation.step
    return {
        "task": episode.task,
        "round": episode.round,
        "split": episode.split,
        "episode": episode.index,
        "seed": episode.seed,
        "first_step": first_step,
        "steps": len(episode.steps),
        "success": episode.success,
        "failure": None if episode.failure is None else episode.failure.value,
        "failed_step": failed,
        VARIATION: None if episode.variation is None else variation_text(episode.variation),
    }


def step_row(episode: Episode, step: Step, scene_row: int, ee_row: int) -> dict[str, Any]:
    """Row of ``steps.parquet``."""
    situation, outcome = step.situation, step.outcome
    i, j, k = step.action.cell
    x_m, y_m, theta_rad = step.action.pose
    row: dict[str, Any] = {
        "task": episode.task,
        "round": episode.round,
        "split": episode.split,
        "episode": episode.index,
        "step": situation.step,
        "last": situation.last,
        "skill": skill(situation.kind),
        "primitive": situation.kind.primitive.value,
        "embodiment": situation.kind.embodiment.value,
        "policy": step.policy,
        "policy_digest": step.policy_digest,
        "action": step.action.index,
        "i": i,
        "j": j,
        "k": k,
        "x_m": x_m,
        "y_m": y_m,
        "theta_rad": theta_rad,
        "success": outcome.success,
        "failure": None if outcome.failure is None else outcome.failure.value,
        "scene_row": scene_row,
        "ee_row": ee_row,
    }
    row.update(outcome.evidence())
    parts: dict[str, Placement | Grip | Pinch | None] = {"target": situation.target, "pinch": situation.pinch}
    parts.update((f"tool{n}", grip) for n, grip in enumerate(situation.grips))
    for prefix, part in parts.items():
        if part is not None:
            row.update(_flat(prefix, part))
    return row


def _flat(prefix: str, part: Placement | Grip | Pinch) -> dict[str, Any]:
    """Columns of an object and its pose."""
    flat = {f"{prefix}_{name}": getattr(part.spec, name) for name in _SPEC}
    flat[f"{prefix}_shape"] = part.spec.shape.value
    names = [field.name for field in dataclasses.fields(part) if field.name != "spec"]
    return flat | {f"{prefix}_{name}": getattr(part, name) for name in names}


def _part(row: Mapping[str, Any], prefix: str, kind: type) -> Any:
    if row[f"{prefix}_shape"] is None:
        return None
    spec = ObjectSpec(Shape(row[f"{prefix}_shape"]), *(row[f"{prefix}_{name}"] for name in _SPEC[1:]))
    names = [field.name for field in dataclasses.fields(kind) if field.name != "spec"]
    return kind(spec, *(row[f"{prefix}_{name}"] for name in names))


def variation_of(episode: Mapping[str, Any]) -> Variation | None:
    """The variation of a row of ``episodes.parquet``; IntegrityError where the column holds something else."""
    text = episode[VARIATION]
    try:
        return None if text is None else variation_from_text(text)
    except ValueError as error:
        place = "/".join(str(episode[name]) for name in ("task", "round", "split", "episode"))
        raise IntegrityError(
            f"the variation of episode {place} cannot be read: {error}", hint="find all damage: rema verify"
        ) from error


def situation_of(row: Mapping[str, Any], variation: Variation | None) -> Situation:
    """What the step of a row of ``steps.parquet`` started from: with its action, all that the simulator needs.

    ``variation`` is that of its episode (``variation_of``), which changes the last step.
    """
    grips = [_part(row, f"tool{n}", Grip) for n in (0, 1)]
    held = tuple(grip for grip in grips if grip is not None)
    target, pinch = _part(row, "target", Placement), _part(row, "pinch", Pinch)
    return Situation(row["task"], int(row["step"]), target, held, pinch, variation if row["last"] else None)


def outcome_of(row: Mapping[str, Any]) -> StepOutcome:
    """The outcome of the step of a row. What it left in the hand is stored with the next step."""
    failure = None if row["failure"] is None else Failure(row["failure"])
    return StepOutcome(bool(row["success"]), failure, **{name: row[name] for name in EVIDENCE})


def action_of(row: Mapping[str, Any]) -> Action:
    """The action of a row."""
    return Action(int(row["action"]))


def _table(rows: Sequence[Mapping[str, Any]], columns: tuple[Column, ...], version: int) -> pa.Table:
    schema = arrow_schema(columns, version)
    return pa.Table.from_pydict({name: [row.get(name) for row in rows] for name in schema.names}, schema=schema)


def episodes_table(rows: Sequence[Mapping[str, Any]], version: int = SCHEMA_VERSION) -> pa.Table:
    """Rows of ``episode_row`` as a table, to be stored in a schema version."""
    return _table(rows, EPISODE_COLUMNS, version)


def steps_table(rows: Sequence[Mapping[str, Any]], version: int = SCHEMA_VERSION) -> pa.Table:
    """Rows of ``step_row`` as a table, to be stored in a schema version."""
    return _table(rows, STEP_COLUMNS, version)


def table_version(table: pa.Table) -> int:
    """The schema version in which a table is stored: the newest one that has its columns."""
    return int((table.schema.metadata or {}).get(b"rema.schema_version", SCHEMA_VERSION))


def with_version(table: pa.Table, version: int) -> pa.Table:
    """A table with all columns, to be stored in another schema version."""
    return table.replace_schema_metadata({"rema.schema_version": str(version)})


def complete(table: pa.Table, columns: tuple[Column, ...]) -> pa.Table:
    """A stored table with all columns: those that are newer than it hold their default. Its version stays."""
    if table.num_columns == len(columns):
        return table
    schema, found = arrow_schema(columns, table_version(table)), set(table.column_names)
    return pa.Table.from_arrays(
        [
            table[column.name] if column.name in found else pa.repeat(pa.scalar(column.default, field.type), len(table))
            for column, field in zip(columns, schema, strict=True)
        ],
        schema=schema,
    )


def as_stored(table: pa.Table, columns: tuple[Column, ...]) -> pa.Table:
    """A table without the columns that are newer than its own version, so that it can be written as it was read."""
    return table.select([column.name for column in columns_at(columns, table_version(table))])


def with_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    """A table with other values in one of its columns."""
    position = table.schema.get_field_index(name)
    field = table.schema.field(position)
    return table.set_column(position, field, pa.array(values, field.type))


def to_parquet(table: pa.Table) -> bytes:
    """A table as Parquet bytes with page checksums, every writer option fixed."""
    buffer = io.BytesIO()
    pq.write_table(
        table,
        buffer,
        version="2.6",
        compression="zstd",
        compression_level=9,
        row_group_size=max(1, table.num_rows),
        data_page_size=1 << 20,
        # Continuous numbers hardly repeat, a block is read whole, and the card says what a column means.
        use_dictionary=[field.name for field in table.schema if field.type != pa.float64()],
        write_statistics=False,
        write_page_checksum=True,
        store_schema=False,
    )
    return buffer.getvalue()


def read_table(
    path: Path, columns: tuple[Column, ...], repair_hint: RepairHint = ask_verify, most_rows: int = MOST_ROWS
) -> pa.Table:
    """A table of a block with all ``columns``, checked; those that are newer than the file hold their default.

    ``table_version`` still gives the version in which it is stored; ``repair_hint`` the hint about a damaged file. A
    file that announces more than ``most_rows`` is not read. Raises MissingFileError, or IntegrityError for a file that
    is not whole or of no schema version that this rema knows.
    """
    try:
        table = parquet_table(path, most_rows, page_checksum_verification=True)
        names = table.schema.names  # decoded here: damaged names are not text
    except FileNotFoundError:
        raise MissingFileError(f"table {path} does not exist", hint=repair_hint(path), path=str(path)) from None
    except (pa.ArrowException, ValueError, OSError) as error:
        raise IntegrityError(f"table {path} is damaged: {error}", hint=repair_hint(path), path=str(path)) from error
    try:
        return checked_table(table, columns)
    except ValueError as error:
        other = {column.name for column in columns} ^ set(names)
        hint = upgrade() if other else repair_hint(path)
        raise IntegrityError(f"table {path} has {error}", hint=hint, path=str(path)) from error


def checked_table(table: pa.Table, columns: tuple[Column, ...]) -> pa.Table:
    """A table as it was stored with all ``columns``; raises ValueError where it is of no known schema version."""
    found = table.schema.names
    for version in range(SCHEMA_VERSION, 0, -1):
        known = columns_at(columns, version)
        expected = arrow_schema(known, version)
        if found == expected.names and table.schema.types == expected.types:
            for column in known:
                if table[column.name].null_count and not column.nullable:
                    raise ValueError(f"nulls in the column {column.name}, which has none")
            return complete(table.replace_schema_metadata(expected.metadata), columns)
    names = {column.name for column in columns} ^ set(found)
    what = f"other columns ({', '.join(sorted(names))})" if names else "columns of other types"
    raise ValueError(f"{what} than schema version {SCHEMA_VERSION}")
