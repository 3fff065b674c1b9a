"""A finished run to browse: every episode of its results table, and its steps from their recorded actions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from evaluator.protocol import protocol_hash
from evaluator.rollout.blank import as_shown
from evaluator.rollout.episode import first_step
from evaluator.run.plan import scenario_list
from evaluator.run.reading import read_run
from evaluator.sim.observation import observe
from evaluator.view.source import Notice, Play, Seen, Source, StepRow
from evaluator.view.table import ID, EpisodeTable, Field
from rema_data import grid
from rema_data.errors import InputError, RemaError
from rema_data.schema import EVIDENCE, Evidence, Scenario

if TYPE_CHECKING:
    from evaluator.render.film import FilmMaker, Take

__all__ = ["RunSource"]

_FIELDS = (
    Field(ID, "the scenario"),
    Field("outcome", "success, failed, or not measured", filtered=True),
    Field("failure", "why the episode failed, null after a success", filtered=True, listed=False),
    Field("failed_step", "position of the step that failed, null after a success", listed=False),
    Field("cell", "axis and level of the suite", filtered=True),
    Field("target_shape", "shape of the object of the last step", filtered=True),
    Field("tool0_shape", "shape of the object of the first pick", filtered=True),
    Field("tool1_shape", "shape of the object of the second pick", filtered=True, listed=False),
    Field("pinch_shape", "shape of the object that is pinched between two sticks", filtered=True, listed=False),
    Field("arm", "left, right, both, or none where nothing had to be simulated", filtered=True, listed=False),
    Field("infra_error", "why there is no measurement", filtered=True, listed=False),
    Field("target_length_m", "length of the target's main bar", "m", listed=False),
    Field("target_x_m", "x of the target in the world", "m", listed=False),
    Field("target_y_m", "y of the target in the world", "m", listed=False),
    Field("target_yaw_rad", "yaw of the target in the world", "rad", listed=False),
)
_SUMMED = "sim_steps"  # of all steps of an episode, where every other piece of evidence is of the step that decided it


class RunSource(Source):
    """See ``Source``."""

    def __init__(self, folder: Path) -> None:
        self._run = run = read_run(folder)
        found = run.provenance
        self.name = f"{run.policy} on {run.task}"
        self.identity = found.seal or found.policy_digest
        self.table = _table(run.table, run.steps, run.targets.cell)
        self.facts = [
            ("policy", f"{run.policy} ({run.tag})"),
            ("task, split, protocol", f"{run.task}, {run.split}, {run.protocol}"),
            ("folder", str(folder)),
            ("policy digest", found.policy_digest),
            ("simulator", ", ".join(f"{name} {value}" for name, value in found.fingerprint.items())),
            *([("seal", found.seal)] if found.seal else []),
        ]
        notices = []
        try:
            self._scenarios  # noqa: B018 - read now, to say at once what cannot be shown
        except RemaError as error:
            notices.append(Notice(f"Steps cannot be drawn or played again here: {error.message}", error.hint))
        if protocol_hash(run.task, run.protocol) != found.protocol_hash:
            notices.append(Notice("This installation has another protocol than the run: expect differences."))
        self.notices = notices

    @cached_property
    def _scenarios(self) -> Sequence[Scenario]:
        return scenario_list(self._run.header).scenarios

    def task(self, place: int) -> str:
        return self._run.task

    def steps(self, place: int) -> Sequence[StepRow]:
        (row,) = self._run.table.slice(place, 1).to_pylist()
        steps = []
        for number in self._run.steps:
            prefix = f"step{number}_"
            found = {name.removeprefix(prefix): value for name, value in row.items() if name.startswith(prefix)}
            if found["success"] is None and found["action"] is None:
                continue
            if found["action"] is not None:
                i, j, k = (int(value) for value in grid.decode(found["action"]))
                found = {"action": found["action"], "i": i, "j": j, "k": k, **found}
            steps.append(StepRow(number, {"policy": self._run.policy, **found}))
        return steps

    def seen(self, place: int, step: int, play: Play) -> Seen:
        if step == self._run.steps[0]:
            situation = first_step(self._scenarios[place], self._run.protocol)
        else:  # what the hand holds follows from the steps before
            situation = play().situation
        if situation.step != step:
            raise InputError(
                f"played again here, {self.table.ids[place]} ends at step {situation.step + 1}",
                hint=f"compare the simulators: rema replay {self._run.source}",
            )
        return Seen(situation, as_shown(observe(situation), self._run.protocol))

    def take(self, place: int, step: int, films: FilmMaker) -> Take:
        (row,) = self._run.table.slice(place, 1).to_pylist()
        return films.play(
            self._scenarios[place], self._run.protocol, lambda situation: row[f"step{situation.step}_action"], step
        )


def _table(results: pa.Table, steps: Sequence[int], cells: Any) -> EpisodeTable:
    success = results["success"]
    outcome = pc.if_else(pc.fill_null(success, False), "success", "failed")
    columns = {
        ID: results["scenario"],
        "outcome": pc.if_else(pc.is_null(success), "not measured", outcome),
        _SUMMED: results[_SUMMED],
    }
    if cells is not None:
        columns["cell"] = pa.array(cells)
    decided = pc.fill_null(results["failed_step"], steps[-1])
    for name in EVIDENCE:
        if name != _SUMMED:
            column = results[f"step{steps[0]}_{name}"]
            for step in steps[1:]:
                column = pc.if_else(pc.equal(decided, step), results[f"step{step}_{name}"], column)
            columns[name] = column
    columns |= {field.name: results[field.name] for field in _FIELDS if field.name in results.column_names}
    measured = [
        Field(item.name, item.metadata["meaning"], item.metadata["unit"])
        for item in Evidence.__dataclass_fields__.values()
        if item.name not in ("arm", _SUMMED)
    ]
    fields = [*_FIELDS, *measured, Field(_SUMMED, "simulation steps of the whole episode")]
    return EpisodeTable([field for field in fields if field.name in columns], columns)
