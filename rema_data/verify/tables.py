"""The tables of one block: what must hold between the columns of a row, the steps of an episode, and the manifest.

All checks work on whole columns. Each rule reports once, with the rows that break it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rema_data import grid
from rema_data.release.manifest import BlockEntry
from rema_data.schema import TASKS, Embodiment, Failure, Primitive, Shape, StepKind, pinch_step, skill, tool_steps
from rema_data.store.block import EPISODES, STEPS
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, Column
from rema_data.verify.rows import rows_of

__all__ = ["PUSH_SUCCESS_M", "TablesReport", "check_tables"]

PUSH_SUCCESS_M = 0.10
"""A push succeeds when the object has moved at least this far in +x (paper, tasks "push" and "grasp -> push")."""

_ARMS = ("left", "right", "both", "none")
_SPEC = ("shape", "length_m", "width_m", "arm_m", "height_m")
_TOOLS = ("tool0", "tool1")
Array = npt.NDArray[Any]
TablesReport = Callable[[str, str, str, str], None]
"""Called with kind, file inside the block, place in it, and detail."""


def check_tables(
    entry: BlockEntry,
    episodes: pa.Table,
    steps: pa.Table,
    map_rows: dict[str, int],
    report: TablesReport,
    *,
    gaps: bool = False,
) -> None:
    """Check the tables of a block.

    Parameters
    ----------
    entry : BlockEntry
        What the manifest says about the block.
    episodes, steps : Table
    map_rows : dict of str to int
        Rows of the map arrays that could be read.
    report : callable
    gaps : bool
        Whether episodes may be missing, as in an import from which some were deleted: those that stay keep their
        numbers, which with the seed say how they were drawn.
    """
    _Check(entry, episodes, steps, report, gaps).run(map_rows)


class _Check:
    """One block while it is checked."""

    def __init__(
        self, entry: BlockEntry, episodes: pa.Table, steps: pa.Table, report: TablesReport, gaps: bool
    ) -> None:
        self.gaps = gaps
        self.entry = entry
        self.kinds = TASKS[entry.task]
        self.episodes = episodes
        self.steps = steps
        self.report = report

    def run(self, map_rows: dict[str, int]) -> None:
        self.counts(map_rows)
        if not (
            self.complete(EPISODES, self.episodes, EPISODE_COLUMNS) and self.complete(STEPS, self.steps, STEP_COLUMNS)
        ):
            return
        self.place()
        self.actions()
        self.numbers()
        self.map_rows(map_rows)
        if self.structure():
            self.endings()
            self.labels()
            self.kinds_of_steps()
            self.policies()
            self.tools()

    def flag(self, kind: str, file: str, bad: Array, detail: str) -> None:
        """Report the rows in which ``bad`` is true, if any."""
        if bad.any():
            self.report(kind, file, rows_of(bad), detail)

    def step(self, name: str) -> Array:
        """A numeric column of the steps; null is NaN."""
        return _numbers(self.steps, name)

    def text(self, name: str) -> Array:
        """A text column of the steps; null is an empty text."""
        return _text(self.steps, name)

    # the whole table

    def counts(self, map_rows: dict[str, int]) -> None:
        """The manifest says how many rows there are."""
        positives = pc.sum(self.episodes["success"]).as_py() or 0
        counted = [
            (EPISODES, "episodes", self.episodes.num_rows, self.entry.episodes),
            (EPISODES, "successful episodes", positives, self.entry.positives),
            (STEPS, "steps", self.steps.num_rows, self.entry.steps),
        ]
        expected = {
            "scene": self.entry.steps,
            "ee_depth": self.entry.end_effectors,
            "ee_mask": self.entry.end_effectors,
        }
        counted += [(f"maps.zarr/{name}", "rows", rows, expected[name]) for name, rows in sorted(map_rows.items())]
        for file, what, found, said in counted:
            if found != said:
                self.report("counts", file, "", f"it has {found:,} {what}, the manifest says {said:,}")

    def complete(self, file: str, table: pa.Table, columns: Sequence[Column]) -> bool:
        """Columns that must have a value have one everywhere."""
        holes = [column.name for column in columns if not column.nullable and table[column.name].null_count]
        for name in holes:
            self.flag("numbers", file, _null(table, name), f"{name} has no value")
        return not holes

    def place(self) -> None:
        """Every row is where its columns say."""
        for file, table in ((EPISODES, self.episodes), (STEPS, self.steps)):
            for name in ("task", "round", "split"):
                value = getattr(self.entry, name)
                column = _text(table, name) if isinstance(value, str) else _numbers(table, name)
                self.flag("place", file, column != value, f"{name} is not {value}, the block's")

    # one row

    def actions(self) -> None:
        """The three forms of an action agree, and it may be taken."""
        index = self.step("action").astype(np.int64)
        i, j, k = (self.step(name).astype(np.int64) for name in "ijk")
        self.flag("actions", STEPS, grid.encode(i, j, k) != index, "action is not (i * 64 + j) * 16 + k")
        pose = grid.to_world(index)
        wrong = [self.step(name) != value for name, value in zip(("x_m", "y_m", "theta_rad"), pose, strict=True)]
        self.flag("actions", STEPS, np.logical_or.reduce(wrong), "x_m, y_m, theta_rad are not the pose of the action")
        row, column, angle = grid.decode(index)
        self.flag(
            "actions", STEPS, ~grid.inside_valid_square()[row, column], "the action is outside of the valid square"
        )
        crossed = (angle >= grid.PAIR_ANGLES) & np.isin(self.text("embodiment"), _two_armed())
        self.flag("actions", STEPS, crossed, f"two arms act at an angle above {grid.PAIR_ANGLES - 1}")

    def numbers(self) -> None:
        """Numbers are finite, sizes positive, evidence not negative, names known."""
        for column in STEP_COLUMNS:
            if column.type == "float64":
                values = self.step(column.name)
                bad = ~np.isfinite(values) & ~_null(self.steps, column.name)
                self.flag("numbers", STEPS, bad, f"{column.name} is not a finite number")
        for part in ("target", *_TOOLS, "pinch"):
            shape = self.text(f"{part}_shape")
            there = shape != ""
            known = np.isin(shape, [item.value for item in Shape])
            self.flag("numbers", STEPS, there & ~known, f"{part}_shape is not I, L or T")
            for name in ("length_m", "width_m", "height_m"):
                self.flag(
                    "numbers", STEPS, there & (self.step(f"{part}_{name}") <= 0), f"{part}_{name} is not positive"
                )
            barred = self.step(f"{part}_arm_m") > 0
            self.flag("numbers", STEPS, there & (barred == (shape == Shape.I)), f"{part}_arm_m contradicts the shape")
        for name in ("lift_m", "peak_force_n", "contact_steps", "illegal_steps", "sim_steps"):
            self.flag("numbers", STEPS, self.step(name) < 0, f"{name} is negative")
        self.flag("labels", STEPS, ~np.isin(self.text("arm"), _ARMS), f"arm is none of {', '.join(_ARMS)}")

    def map_rows(self, rows: dict[str, int]) -> None:
        """Every step has a scene of its own; every end-effector map is used."""
        if "scene" in rows:
            self.covered("scene_row", rows["scene"], once=True)
        if "ee_depth" in rows:
            self.covered("ee_row", rows["ee_depth"], once=False)

    def covered(self, name: str, count: int, *, once: bool) -> None:
        row = self.step(name).astype(np.int64)
        outside = (row < 0) | (row >= count)
        self.flag("rows", STEPS, outside, f"{name} is outside of the {count:,} rows of the maps")
        used = np.bincount(row[~outside], minlength=count)
        maps = f"maps.zarr/{'scene' if once else 'ee_depth'}"
        self.flag("rows", maps, used == 0, "no step uses the map")
        self.flag("rows", maps, (used > 1) & once, "several steps use the map")

    # one episode

    @cached_property
    def length(self) -> Array:
        """Executed steps of every episode."""
        return np.asarray(_numbers(self.episodes, "steps"), np.int64)

    @cached_property
    def first(self) -> Array:
        """Row of every episode's first step, as the lengths have it."""
        return np.asarray(np.cumsum(self.length) - self.length)

    @cached_property
    def position(self) -> Array:
        """Position in its task of every row of the steps."""
        return np.asarray(np.arange(self.steps.num_rows) - np.repeat(self.first, self.length))

    def structure(self) -> bool:
        """Episodes count from 0, or with gaps at least upwards, and their steps follow each other without a gap."""
        impossible = (self.length < 1) | (self.length > len(self.kinds))
        self.flag("episodes", EPISODES, impossible, f"steps is not 1 to {len(self.kinds)}")
        number = _numbers(self.episodes, "episode")
        if self.gaps:
            self.flag("episodes", EPISODES, np.diff(number, prepend=-1) < 1, "episodes do not count upwards")
        else:
            self.flag("episodes", EPISODES, number != np.arange(len(number)), "episodes do not count from 0")
        if impossible.any():
            return False
        if self.length.sum() != self.steps.num_rows:
            detail = f"its episodes have {self.length.sum():,} steps, {STEPS} has {self.steps.num_rows:,}"
            self.report("episodes", EPISODES, "", detail)
            return False
        started = _numbers(self.episodes, "first_step") != self.first
        self.flag("episodes", EPISODES, started, "first_step is not where the episode before it ends")
        owner = np.repeat(number, self.length)
        strangers = (self.step("episode") != owner) | (self.step("step") != self.position)
        self.flag("episodes", STEPS, strangers, "episode and step are not those that episodes.parquet has for the row")
        return not strangers.any()

    def endings(self) -> None:
        """An episode goes on until its first failed step, and takes its success and label from its last one."""
        final = self.first + self.length - 1
        success = self.step("success").astype(bool)
        ends = np.zeros(len(success), bool)
        ends[final] = True
        whole = self.length == len(self.kinds)
        self.flag("episodes", STEPS, ~success & ~ends, "the step failed, but the episode goes on")
        self.flag("episodes", EPISODES, success[final] & ~whole, "the episode ends early, after a step that succeeded")
        won = _numbers(self.episodes, "success").astype(bool)
        self.flag("labels", EPISODES, won != (success[final] & whole), "success contradicts the last executed step's")
        label = _text(self.episodes, "failure")
        self.flag("labels", EPISODES, label != self.text("failure")[final], "failure is not the last executed step's")
        failed = _numbers(self.episodes, "failed_step")
        wrong = np.where(won, ~np.isnan(failed), failed != self.length - 1)
        self.flag("labels", EPISODES, wrong, "failed_step is not the step at which the episode ended")

    def labels(self) -> None:
        """A failed step has exactly one known label, and no evidence speaks against its success."""
        success = self.step("success").astype(bool)
        label = self.text("failure")
        self.flag("labels", STEPS, success & (label != ""), "the step succeeded, and has a failure label")
        self.flag("labels", STEPS, ~success & (label == ""), "the step failed, and has no failure label")
        known = np.isin(label, [item.value for item in Failure])
        self.flag("labels", STEPS, (label != "") & ~known, "the failure label is not one of the schema")
        pushes = np.array([kind.primitive is Primitive.PUSH for kind in self.kinds])[self.position]
        far = self.step("displacement_m") >= PUSH_SUCCESS_M
        self.flag(
            "labels", STEPS, success & pushes & ~far, f"a successful push moved the object less than {PUSH_SUCCESS_M} m"
        )
        self.flag(
            "labels",
            STEPS,
            (label == Failure.TOO_LITTLE) & far,
            f"labelled {Failure.TOO_LITTLE}, but moved {PUSH_SUCCESS_M} m or more",
        )
        lifted = self.step("lift_m") > 0
        self.flag("labels", STEPS, success & ~pushes & ~lifted, "a successful grasp did not lift the object")

    def kinds_of_steps(self) -> None:
        """Every step is of the kind that its task has at its position."""
        last = self.position == len(self.kinds) - 1
        self.flag("place", STEPS, self.step("last").astype(bool) != last, "last is wrong for this step of the task")
        named: dict[str, Callable[[StepKind], str]] = {
            "skill": skill,
            "primitive": lambda kind: kind.primitive.value,
            "embodiment": lambda kind: kind.embodiment.value,
        }
        for name, value in named.items():
            expected = np.array([value(kind) for kind in self.kinds], object)[self.position]
            self.flag("place", STEPS, self.text(name) != expected, f"{name} is not that of this step of the task")

    def policies(self) -> None:
        """The manifest names the behaviour policy of every step."""
        policy = self.text("policy")
        for number, said in enumerate(self.entry.policies[: len(self.kinds)]):
            bad = (self.position == number) & ~np.isin(policy, said.split("+"))
            self.flag("place", STEPS, bad, f"the policy of step {number} is not {said}, as the manifest says")

    # what is held

    def tools(self) -> None:
        """Tools are there exactly where they were picked, are what was picked, and stay as they are."""
        made = dict(zip(_TOOLS, tool_steps(self.entry.task), strict=False)) | {"pinch": pinch_step(self.entry.task)}
        for part in (*_TOOLS, "pinch"):
            columns = [column.name for column in STEP_COLUMNS if column.name.startswith(f"{part}_")]
            step = made.get(part)
            after = len(self.kinds) if step is None else step
            held = self.position > after
            there = np.array([~_null(self.steps, name) for name in columns])
            self.flag("tools", STEPS, held & ~there.all(axis=0), f"{part} is missing")
            self.flag("tools", STEPS, ~held & there.any(axis=0), f"{part} is there, but nothing was picked yet")
            rows = np.flatnonzero(held & there.all(axis=0))
            picked = rows - self.position[rows] + after
            changed = self.differ(rows, [f"{part}_{name}" for name in _SPEC], picked, [f"target_{n}" for n in _SPEC])
            self.flag("tools", STEPS, changed, f"{part} is not the object that was picked at step {after}")
            carried = rows[self.position[rows] > after + 1]
            moved = self.differ(carried, columns, carried - 1, columns)
            self.flag("tools", STEPS, moved, f"{part} is not as it was at the step before")

    def differ(self, rows: Array, names: Sequence[str], others: Array, as_names: Sequence[str]) -> Array:
        """Rows whose columns ``names`` are not those named ``as_names`` of other rows, bool (steps,)."""
        bad = np.zeros(self.steps.num_rows, bool)
        for name, other in zip(names, as_names, strict=True):
            read = self.text if name.endswith("_shape") else self.step
            bad[rows] |= read(name)[rows] != read(other)[others]
        return bad


def _two_armed() -> list[str]:
    return [item.value for item in Embodiment if item.two_arms]


def _numbers(table: pa.Table, name: str) -> Array:
    """A column of numbers or booleans; null is NaN."""
    return np.asarray(table[name].to_numpy())


def _text(table: pa.Table, name: str) -> Array:
    """A column of text as objects; null is an empty text."""
    return np.asarray(pc.fill_null(table[name], "").to_numpy(), object)


def _null(table: pa.Table, name: str) -> Array:
    return np.asarray(pc.is_null(table[name]).to_numpy(), bool)
