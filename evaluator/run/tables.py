"""The tables of a run: ``results.parquet``, one row an episode, and ``timings.parquet`` beside it.

``results.parquet`` is a function of the scenarios, the answers and the outcomes alone: the same bytes for any
number of workers, any engine, and after a kill or a resume. All that may differ is in ``timings.parquet``.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from evaluator.engines.base import InfraError
from evaluator.run.records import Records
from evaluator.scenarios import ScenarioList, scenario_id
from rema_data import grid
from rema_data.bounded import parquet_file
from rema_data.schema import TASKS, Evidence, Failure, ObjectSpec, Scenario, StepOutcome, pinch_step, tool_steps

__all__ = [
    "TIMINGS_SCHEMA",
    "Verdict",
    "first_line",
    "read_results",
    "results_schema",
    "results_table",
    "scenario_columns",
    "timings_table",
    "to_parquet",
    "verdict",
]

_EVIDENCE_TYPES = {"str": pa.string(), "float": pa.float64(), "int": pa.int64()}
_STEP_FIELDS: tuple[tuple[str, pa.DataType], ...] = (
    ("action", pa.uint16()),
    ("x_m", pa.float64()),
    ("y_m", pa.float64()),
    ("theta_rad", pa.float64()),
    ("success", pa.bool_()),
    ("failure", pa.string()),
    *((item.name, _EVIDENCE_TYPES[str(item.type).removesuffix(" | None")]) for item in dataclasses.fields(Evidence)),
)
TIMINGS_SCHEMA = pa.schema(
    {
        "index": pa.int32(),
        "step": pa.int8(),
        "seconds": pa.float64(),
        "worker": pa.string(),
        "segment": pa.int32(),
        "attempt": pa.int8(),
    }
)
_NAMED = 5


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of an episode."""

    success: bool | None  # None: not measured (not eligible, not finished, or lost to the infrastructure)
    failure: Failure | None = None
    failed_step: int | None = None
    infra_error: str | None = None  # why there is no measurement


def verdict(index: int, steps: Sequence[int], records: Records) -> Verdict:
    """Verdict on the episode of scenario ``index``, whose policy acts in ``steps``."""
    for step in steps:
        result = records.result(index, step)
        if result is None:
            return Verdict(None)
        if isinstance(result, InfraError):
            return Verdict(None, infra_error=result.reason)
        if not result.success:
            return Verdict(False, result.failure, step)
    return Verdict(True)


def results_schema(task: str) -> pa.Schema:
    """Columns of the results table and their types."""
    text, real = pa.string(), pa.float64()
    fields = [("scenario", text), ("index", pa.int32()), ("task", text), ("split", text)]
    fields += [
        (f"target_{field.name}", text if field.name == "shape" else real) for field in dataclasses.fields(ObjectSpec)
    ]
    fields += [("target_x_m", real), ("target_y_m", real), ("target_yaw_rad", real)]
    fields += [(f"tool{n}_shape", text) for n in range(len(tool_steps(task)))]
    fields += [("pinch_shape", text)] if pinch_step(task) is not None else []
    for step in range(len(TASKS[task])):
        fields += [(f"step{step}_{name}", kind) for name, kind in _STEP_FIELDS]
    fields += [("success", pa.bool_()), ("failure", text), ("failed_step", pa.int8())]
    fields += [("sim_steps", pa.int64()), ("infra_error", text)]
    return pa.schema(fields)


def scenario_columns(task: str) -> tuple[str, ...]:
    """Columns that follow from the scenario alone: those before the first step's."""
    names = results_schema(task).names
    return tuple(names[: names.index(f"step0_{_STEP_FIELDS[0][0]}")])


def _step_row(step: int, action: int | None, result: StepOutcome | InfraError | None) -> dict[str, Any]:
    row: dict[str, Any] = {}
    if action is not None:
        x_m, y_m, theta_rad = grid.to_world(action)
        row = {"action": action, "x_m": float(x_m), "y_m": float(y_m), "theta_rad": float(theta_rad)}
    if isinstance(result, StepOutcome):
        row["success"] = result.success
        row["failure"] = None if result.failure is None else result.failure.value
        if action is not None:  # nothing was measured where the policy gave no action
            row.update(result.evidence())
    return {f"step{step}_{name}": value for name, value in row.items()}


def _episode_row(scenario: Scenario, version: str, steps: Sequence[int], records: Records) -> dict[str, Any]:
    target = scenario.placements[-1]
    row: dict[str, Any] = {
        "scenario": scenario_id(version, scenario),
        "index": scenario.index,
        "task": scenario.task,
        "split": scenario.split,
        **{f"target_{field.name}": getattr(target.spec, field.name) for field in dataclasses.fields(ObjectSpec)},
        "target_x_m": target.x_m,
        "target_y_m": target.y_m,
        "target_yaw_rad": target.yaw_rad,
    }
    tools = len(tool_steps(scenario.task))
    row.update({f"tool{n}_shape": scenario.placements[n].spec.shape.value for n in range(tools)})
    row["pinch_shape"] = scenario.placements[tools].spec.shape.value
    row["target_shape"] = target.spec.shape.value
    simulated = 0
    for step in steps:
        answer, result = records.answers.get((scenario.index, step)), records.result(scenario.index, step)
        row.update(_step_row(step, None if answer is None else answer.action, result))
        simulated += result.sim_steps if isinstance(result, StepOutcome) else 0
    end = verdict(scenario.index, steps, records)
    row["success"], row["failed_step"], row["infra_error"] = end.success, end.failed_step, end.infra_error
    row["failure"] = None if end.failure is None else end.failure.value
    row["sim_steps"] = simulated
    return row


def results_table(scenarios: ScenarioList, episodes: int, steps: Sequence[int], records: Records) -> pa.Table:
    """One row for each of the first ``episodes`` scenarios, in their order.

    Columns: the scenario and its objects; ``step{n}_*`` with action (grid index, null where there was none), pose
    (metres and radians in the world frame), outcome and evidence; ``success`` (null where not measured), ``failure``,
    ``failed_step``, ``sim_steps`` (sum over steps) and ``infra_error``.
    """
    schema = results_schema(scenarios.task)
    chosen = scenarios.scenarios[:episodes]
    rows = [_episode_row(scenario, scenarios.version, steps, records) for scenario in chosen]
    return pa.Table.from_pydict({name: [row.get(name) for row in rows] for name in schema.names}, schema=schema)


def read_results(payload: bytes, task: str) -> tuple[pa.Table | None, pa.Table | None, list[tuple[str, str]]]:
    """A results table from the bytes of its file: the table, the same as stored, and what is wrong with it.

    Columns of ``results_schema`` that are newer than the file are null in the first table and missing in the second.
    Both are None where the file cannot be read. A problem is a column (empty for all) and a description.
    """
    schema = results_schema(task)
    broken = (pa.ArrowException, OSError, ValueError)
    try:
        file = parquet_file(payload)
        names = list(file.schema_arrow.names)
    except broken as error:
        return None, None, [("", f"cannot be read: {first_line(error)}")]
    later = {
        f"step{step}_{item.name}"
        for step in range(len(TASKS[task]))
        for item in dataclasses.fields(Evidence)
        if item.metadata["since"] > 1
    }
    lacking = [name for name in schema.names if name not in names and name not in later]
    unknown = [name for name in names if name not in schema.names]
    if lacking or unknown or len(set(names)) != len(names):
        wrong = [f"lacks {name}" for name in lacking] + [f"has an unknown column {name}" for name in unknown]
        return None, None, [("", "; ".join(wrong[:_NAMED]) or "has a column twice")]
    columns, problems = [], []
    for name in names:
        try:
            column = file.read(columns=[name]).column(0)
            column.validate(full=True)
        except broken as error:
            problems.append((f"column {name}, all rows", f"cannot be read: {first_line(error)}"))
            continue
        if column.type != schema.field(name).type:
            problems.append((f"column {name}", f"is {column.type}, not {schema.field(name).type}"))
        columns.append(column)
    if problems or len({len(column) for column in columns}) != 1:
        return None, None, problems or [("", "has columns of different lengths")]
    stored = pa.table(columns, names=names)
    rows = stored.num_rows
    absent = {name: pa.nulls(rows, schema.field(name).type) for name in schema.names if name not in names}
    table = pa.table([absent[name] if name in absent else stored[name] for name in schema.names], schema=schema)
    if rows == 0 or table["index"].to_pylist() != list(range(rows)):
        problems.append(("", "does not have one row for every scenario from 0 on, in order"))
    return table, stored, problems


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def timings_table(records: Records, episodes: int) -> pa.Table:
    """One row for each simulated step of the first ``episodes`` scenarios: seconds, worker, segment and attempt."""
    simulated = [records.outcomes[key] for key in sorted(records.outcomes) if key[0] < episodes]
    content = {name: [getattr(record, name) for record in simulated] for name in TIMINGS_SCHEMA.names}
    return pa.Table.from_pydict(content, schema=TIMINGS_SCHEMA)


def to_parquet(table: pa.Table, page_checksums: bool = False) -> bytes:
    """A table as Parquet bytes, with every writer option fixed; checksums are for a table that no seal covers."""
    buffer = io.BytesIO()
    pq.write_table(
        table,
        buffer,
        version="2.6",
        compression="zstd",
        compression_level=3,
        row_group_size=max(1, table.num_rows),
        data_page_size=1 << 20,
        use_dictionary=True,
        write_statistics=True,
        write_page_checksum=page_checksums,
        store_schema=False,
    )
    return buffer.getvalue()
