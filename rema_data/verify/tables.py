"""The tables of one block: what must hold between the columns of a row, the steps of an episode, and the manifest.

All checks work on whole columns. Each rule reports once, with the rows that break it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rema_data import grid
from rema_data.release.manifest import BlockEntry
from rema_data.schema import SEED_SHAPES, TASKS, Embodiment, Failure, Primitive, Shape, pinch_step, skill, tool_steps
from rema_data.store.block import EPISODES, STEPS
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, VARIATION
from rema_data.verify.findings import Add, rows_of
from rema_data.verify.variations import check_variations

__all__ = ["PUSH_SUCCESS_M", "check_tables"]

PUSH_SUCCESS_M = 0.10
"""A push succeeds when the object has moved at least this far in +x (paper, tasks "push" and "grasp -> push")."""

_ARMS = ("left", "right", "both", "none")
_SPEC = ("shape", "length_m", "width_m", "arm_m", "height_m")
_OBJECTS = ("target", "tool0", "tool1", "pinch")
_COUNTED = ("lift_m", "peak_force_n", "contact_steps", "illegal_steps", "sim_steps")
Array = npt.NDArray[Any]


def check_tables(
    entry: BlockEntry,
    episodes: pa.Table,
    steps: pa.Table,
    map_rows: dict[str, int],
    report: Add,
    *,
    gaps: bool = False,
) -> None:
    """Check the tables of a block against each other, ``entry``, and the rows of the map arrays that could be read.

    ``gaps`` allows missing episodes, as in an import from which some were deleted: those that stay keep their numbers,
    which with the seed say how they were drawn.
    """
    for file, what, found, said in _counts(entry, episodes, steps, map_rows):
        if found != said:
            report("counts", file, "", f"it has {found:,} {what}, the manifest says {said:,}")
    complete = True
    for file, table, columns in ((EPISODES, episodes, EPISODE_COLUMNS), (STEPS, steps, STEP_COLUMNS)):
        for name in (column.name for column in columns if not column.nullable and table[column.name].null_count):
            report("numbers", file, rows_of(_null(table, name)), f"{name} has no value")
            complete = False
    if complete:
        check_variations(episodes, report)
        _Check(entry, episodes, steps, report, gaps).run(map_rows)


def _counts(
    entry: BlockEntry, episodes: pa.Table, steps: pa.Table, map_rows: dict[str, int]
) -> list[tuple[str, str, int, int]]:
    """Rows that there are, and that the manifest says, with file and name."""
    return [
        (EPISODES, "episodes", episodes.num_rows, entry.episodes),
        (EPISODES, "successful episodes", pc.sum(episodes["success"]).as_py() or 0, entry.positives),
        (STEPS, "steps", steps.num_rows, entry.steps),
        *(
            (f"maps.zarr/{name}", "rows", rows, entry.steps if name == "scene" else entry.end_effectors)
            for name, rows in sorted(map_rows.items())
        ),
    ]


class _Check:
    """One block while it is checked."""

    def __init__(self, entry: BlockEntry, episodes: pa.Table, steps: pa.Table, report: Add, gaps: bool) -> None:
        self.entry = entry
        self.kinds = TASKS[entry.task]
        self.table = steps
        self.episodes = _columns(episodes)
        self.steps = _columns(steps)
        self.report = report
        self.gaps = gaps
        self.length = self.episodes["steps"].astype(np.int64)
        """Executed steps of every episode."""
        self.first = np.cumsum(self.length) - self.length
        """Row of every episode's first step, as the lengths have it."""

    def run(self, map_rows: dict[str, int]) -> None:
        self.place()
        self.actions()
        self.numbers()
        for name, maps, once in (("scene_row", "scene", True), ("ee_row", "ee_depth", False)):
            if maps in map_rows:
                self.map_rows(name, maps, map_rows[maps], once)
        if self.structure():
            # Position in its task of every row of the steps.
            self.position = np.arange(self.table.num_rows) - np.repeat(self.first, self.length)
            self.ends_of_episodes()
            self.labels()
            self.step_kinds()
            self.tools()
            self.clean()

    def flag(self, kind: str, bad: Array, detail: str, file: str = STEPS) -> None:
        """Report the rows in which ``bad`` is true, if any."""
        if bad.any():
            self.report(kind, file, rows_of(bad), detail)

    # one row

    def place(self) -> None:
        """Every row is where its columns say."""
        for file, columns in ((EPISODES, self.episodes), (STEPS, self.steps)):
            for name in ("task", "round", "split"):
                value = getattr(self.entry, name)
                self.flag("place", columns[name] != value, f"{name} is not {value}, the block's", file)

    def actions(self) -> None:
        """The three forms of an action agree, and it may be taken."""
        index, i, j, k = (self.steps[name].astype(np.int64) for name in ("action", *"ijk"))
        self.flag("actions", grid.encode(i, j, k) != index, "action is not (i * 64 + j) * 16 + k")
        pose = zip(("x_m", "y_m", "theta_rad"), grid.to_world(index), strict=True)
        wrong = np.logical_or.reduce([self.steps[name] != value for name, value in pose])
        self.flag("actions", wrong, "x_m, y_m, theta_rad are not the pose of the action")
        row, column, angle = grid.decode(index)
        inside = grid.inside_valid_square()[row, column]
        self.flag("actions", ~inside, "the action is outside of the valid square")
        two_arms = np.isin(self.steps["embodiment"], [item.value for item in Embodiment if item.two_arms])
        crossed = (angle >= grid.PAIR_ANGLES) & two_arms
        self.flag("actions", crossed, f"two arms act at an angle above {grid.PAIR_ANGLES - 1}")

    def numbers(self) -> None:
        """Numbers are finite, sizes positive, evidence not negative, names known."""
        steps = self.steps
        for name in (column.name for column in STEP_COLUMNS if column.type == "float64"):
            bad = ~np.isfinite(steps[name]) & ~_null(self.table, name)
            self.flag("numbers", bad, f"{name} is not a finite number")
        for part in _OBJECTS:
            shape = steps[f"{part}_shape"]
            there, known = shape != "", np.isin(shape, [item.value for item in Shape])
            self.flag("numbers", there & ~known, f"{part}_shape is not a known shape")
            for name in (f"{part}_{size}" for size in ("length_m", "width_m", "height_m")):
                self.flag("numbers", there & (steps[name] <= 0), f"{name} is not positive")
            contradicts = (steps[f"{part}_arm_m"] > 0) == (shape == Shape.I)
            self.flag("numbers", there & contradicts, f"{part}_arm_m contradicts the shape")
        for name in _COUNTED:
            self.flag("numbers", steps[name] < 0, f"{name} is negative")
        self.flag("labels", ~np.isin(steps["arm"], _ARMS), f"arm is not one of {', '.join(_ARMS)}")

    def map_rows(self, name: str, maps: str, count: int, once: bool) -> None:
        """Every step has a scene of its own; every end-effector map is used."""
        row = self.steps[name].astype(np.int64)
        outside = (row < 0) | (row >= count)
        self.flag("rows", outside, f"{name} is outside of the {count:,} rows of the maps")
        used = np.bincount(row[~outside], minlength=count)
        self.flag("rows", used == 0, "no step uses the map", f"maps.zarr/{maps}")
        self.flag("rows", (used > 1) & once, "several steps use the map", f"maps.zarr/{maps}")

    # one episode

    def structure(self) -> bool:
        """Episodes count from 0, or with gaps at least upwards, and their steps follow each other without a gap."""
        impossible = (self.length < 1) | (self.length > len(self.kinds))
        self.flag("episodes", impossible, f"steps is not 1 to {len(self.kinds)}", EPISODES)
        number = self.episodes["episode"]
        if self.gaps:
            self.flag("episodes", np.diff(number, prepend=-1) < 1, "episodes do not count upwards", EPISODES)
        else:
            self.flag("episodes", number != np.arange(len(number)), "episodes do not count from 0", EPISODES)
        if impossible.any():
            return False
        if self.length.sum() != self.table.num_rows:
            detail = f"its episodes have {self.length.sum():,} steps, {STEPS} has {self.table.num_rows:,}"
            self.report("episodes", EPISODES, "", detail)
            return False
        started = self.episodes["first_step"] != self.first
        self.flag("episodes", started, "first_step is not where the episode before it ends", EPISODES)
        position = np.arange(self.table.num_rows) - np.repeat(self.first, self.length)
        foreign = (self.steps["episode"] != np.repeat(number, self.length)) | (self.steps["step"] != position)
        self.flag("episodes", foreign, "episode and step are not those that episodes.parquet has for the row")
        return not foreign.any()

    def ends_of_episodes(self) -> None:
        """An episode continues until its first failed step, and takes its success and label from its last one."""
        final = self.first + self.length - 1
        success, failed = self.steps["success"].astype(bool), self.episodes["failed_step"]
        goes_on = np.ones(len(success), bool)
        goes_on[final] = False
        self.flag("episodes", ~success & goes_on, "the step failed, but the episode continues")
        whole, won = self.length == len(self.kinds), self.episodes["success"].astype(bool)
        early = success[final] & ~whole
        self.flag("episodes", early, "the episode ends early, after a step that succeeded", EPISODES)
        contradicts = won != (success[final] & whole)
        self.flag("labels", contradicts, "success contradicts the last executed step's", EPISODES)
        other = self.episodes["failure"] != self.steps["failure"][final]
        self.flag("labels", other, "failure is not the last executed step's", EPISODES)
        wrong = np.where(won, ~np.isnan(failed), failed != self.length - 1)
        self.flag("labels", wrong, "failed_step is not the step at which the episode ended", EPISODES)

    def labels(self) -> None:
        """A failed step has exactly one known label, and no evidence speaks against its success."""
        success, label = self.steps["success"].astype(bool), self.steps["failure"]
        known = np.isin(label, [item.value for item in Failure])
        self.flag("labels", success & (label != ""), "the step succeeded, and has a failure label")
        self.flag("labels", ~success & (label == ""), "the step failed, and has no failure label")
        self.flag("labels", (label != "") & ~known, "the failure label is not one of the schema")
        pushes = self.of_kinds([kind.primitive is Primitive.PUSH for kind in self.kinds]).astype(bool)
        far, moved = self.steps["displacement_m"] >= PUSH_SUCCESS_M, f"{PUSH_SUCCESS_M} m"
        self.flag("labels", success & pushes & ~far, f"a successful push moved the object less than {moved}")
        short = label == Failure.TOO_LITTLE
        self.flag("labels", short & far, f"labelled {Failure.TOO_LITTLE}, but moved {moved} or more")
        lifted = self.steps["lift_m"] > 0
        self.flag("labels", success & ~pushes & ~lifted, "a successful grasp did not lift the object")

    def step_kinds(self) -> None:
        """Every step is of the kind that its task has at its position, and by the policy that the manifest names."""
        last = self.position == len(self.kinds) - 1
        self.flag("place", self.steps["last"].astype(bool) != last, "last is wrong for this step of the task")
        for name, values in (
            ("skill", [skill(kind) for kind in self.kinds]),
            ("primitive", [kind.primitive.value for kind in self.kinds]),
            ("embodiment", [kind.embodiment.value for kind in self.kinds]),
        ):
            other = self.steps[name] != self.of_kinds(values)
            self.flag("place", other, f"{name} is not that of this step of the task")
        for number, said in enumerate(self.entry.policies[: len(self.kinds)]):
            bad = (self.position == number) & ~np.isin(self.steps["policy"], said.split("+"))
            self.flag("place", bad, f"the policy of step {number} is not {said}, as the manifest says")

    def of_kinds(self, values: Sequence[Any]) -> Array:
        """For every row of the steps the value at its position in the task."""
        return np.asarray(np.array(values, object)[self.position])

    # what is held

    def tools(self) -> None:
        """Tools are there exactly where they were picked, are what was picked, and stay as they are."""
        left, right = (*tool_steps(self.entry.task), None, None)[:2]
        for part, step in (("tool0", left), ("tool1", right), ("pinch", pinch_step(self.entry.task))):
            columns = [column.name for column in STEP_COLUMNS if column.name.startswith(f"{part}_")]
            after = len(self.kinds) if step is None else step
            held = self.position > after
            there = np.array([~_null(self.table, name) for name in columns])
            self.flag("tools", held & ~there.all(axis=0), f"{part} is missing")
            self.flag("tools", ~held & there.any(axis=0), f"{part} is there, but nothing was picked yet")
            rows = np.flatnonzero(held & there.all(axis=0))
            picked = rows - self.position[rows] + after
            changed = self.differ(rows, [f"{part}_{name}" for name in _SPEC], picked, [f"target_{n}" for n in _SPEC])
            self.flag("tools", changed, f"{part} is not the object that was picked at step {after}")
            carried = rows[self.position[rows] > after + 1]
            moved = self.differ(carried, columns, carried - 1, columns)
            self.flag("tools", moved, f"{part} is not as it was at the step before")

    # what is varied

    def clean(self) -> None:
        """Without a variation, objects have the shapes of the paper."""
        clean = np.repeat(self.episodes[VARIATION] == "", self.length)
        for part in _OBJECTS:
            shape = self.steps[f"{part}_shape"]
            other = (shape != "") & ~np.isin(shape, [item.value for item in SEED_SHAPES])
            self.flag("numbers", clean & other, f"{part}_shape is not I, L or T, and the episode is clean")

    def differ(self, rows: Array, names: Sequence[str], others: Array, as_names: Sequence[str]) -> Array:
        """Rows whose columns ``names`` are not those named ``as_names`` of other rows, bool (steps,)."""
        bad = np.zeros(self.table.num_rows, bool)
        for name, other in zip(names, as_names, strict=True):
            bad[rows] |= self.steps[name][rows] != self.steps[other][others]
        return bad


def _columns(table: pa.Table) -> dict[str, Array]:
    """Columns by name: numbers and booleans, in which null is NaN, and text as objects, in which null is empty."""

    def read(column: pa.ChunkedArray) -> Array:
        text = pa.types.is_string(column.type) or pa.types.is_dictionary(column.type)
        return np.asarray(pc.fill_null(column, "").to_numpy(), object) if text else np.asarray(column.to_numpy())

    return {name: read(table[name]) for name in table.schema.names}


def _null(table: pa.Table, name: str) -> Array:
    return np.asarray(pc.is_null(table[name]).to_numpy(), bool)
