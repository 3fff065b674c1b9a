"""The tables of a run: ``episodes.parquet``, one row an episode, and ``timings.parquet`` beside it.

``episodes.parquet`` is a function of the scenarios, the answers and the outcomes alone: the same bytes whatever the
number of workers, the engine, a kill or a resume. All that may differ between equal runs is in ``timings.parquet``.
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
from evaluator.scenarios import ScenarioList, reference_pinch, reference_tools, scenario_id
from rema_data import grid
from rema_data.schema import TASKS, Evidence, Failure, ObjectSpec, Scenario, StepOutcome

__all__ = [
    "Verdict",
    "episodes_schema",
    "episodes_table",
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
    *((item.name, _EVIDENCE_TYPES[str(item.type)]) for item in dataclasses.fields(Evidence)),
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """How an episode ended.

    Attributes
    ----------
    success : bool or None
        None where it was not measured: not eligible, not finished, or lost to the infrastructure.
    failure : Failure or None
    failed_step : int or None
    infra_error : str or None
        Reason for which there is no measurement.
    """

    success: bool | None
    failure: Failure | None = None
    failed_step: int | None = None
    infra_error: str | None = None


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


def episodes_schema(task: str) -> pa.Schema:
    """Columns of ``episodes.parquet`` and their types."""
    text, real = pa.string(), pa.float64()
    fields = [("scenario", text), ("index", pa.int32()), ("task", text), ("split", text)]
    fields += [
        (f"target_{field.name}", text if field.name == "shape" else real) for field in dataclasses.fields(ObjectSpec)
    ]
    fields += [("target_x_m", real), ("target_y_m", real), ("target_yaw_rad", real)]
    fields += [(f"tool{n}_shape", text) for n in range(reference_tools(task))]
    fields += [("pinch_shape", text)] if reference_pinch(task) else []
    for step in range(len(TASKS[task])):
        fields += [(f"step{step}_{name}", kind) for name, kind in _STEP_FIELDS]
    fields += [("success", pa.bool_()), ("failure", text), ("failed_step", pa.int8())]
    fields += [("sim_steps", pa.int64()), ("infra_error", text)]
    return pa.schema(fields)


def scenario_columns(task: str) -> tuple[str, ...]:
    """Columns that follow from the scenario alone: those before the first step's."""
    names = episodes_schema(task).names
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
    tools = reference_tools(scenario.task)
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


def episodes_table(scenarios: ScenarioList, episodes: int, steps: Sequence[int], records: Records) -> pa.Table:
    """One row for each of the first ``episodes`` scenarios, in their order.

    Parameters
    ----------
    scenarios : ScenarioList
    episodes : int
    steps : sequence of int
        Steps in which the policy acts: the last one (conditional) or all (end-to-end).
    records : Records

    Returns
    -------
    pyarrow.Table
        Columns: the scenario and its objects; ``step{n}_*`` with action (grid index, null where there was none), pose
        (metres and radians in the world frame), outcome and evidence; ``success`` (null where not measured),
        ``failure``, ``failed_step``, ``sim_steps`` (sum over steps) and ``infra_error``.
    """
    schema = episodes_schema(scenarios.task)
    chosen = scenarios.scenarios[:episodes]
    rows = [_episode_row(scenario, scenarios.version, steps, records) for scenario in chosen]
    return pa.Table.from_pydict({name: [row.get(name) for row in rows] for name in schema.names}, schema=schema)


def timings_table(records: Records, episodes: int) -> pa.Table:
    """One row for each simulated step of the first ``episodes`` scenarios: seconds, worker, segment and attempt."""
    simulated = [records.outcomes[key] for key in sorted(records.outcomes) if key[0] < episodes]
    columns = {
        "index": pa.int32(),
        "step": pa.int8(),
        "seconds": pa.float64(),
        "worker": pa.string(),
        "segment": pa.int32(),
        "attempt": pa.int8(),
    }
    content = {name: [getattr(record, name) for record in simulated] for name in columns}
    return pa.Table.from_pydict(content, schema=pa.schema(columns))


def to_parquet(table: pa.Table) -> bytes:
    """A table as Parquet bytes, with every writer option fixed."""
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
        store_schema=False,
    )
    return buffer.getvalue()
