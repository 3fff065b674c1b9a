"""Rows that contradict themselves, each other or the manifest are found."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.sim.parameters import WORLD
from rema_data.grid import encode
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import BlockEntry
from rema_data.schema import TASKS, Failure
from rema_data.store.block import BlockKey
from rema_data.verify import verify
from rema_data.verify.tables import PUSH_SUCCESS_M, check_tables
from tests.rema_data.verify.damage import GRASP_TRAIN, change_cell, location, reseal, with_value, with_values

Tables = tuple[pa.Table, pa.Table]
EPISODES, STEPS = "episodes.parquet", "steps.parquet"


def findings(whole: ReleaseFolder, task: str, change: Callable[[pa.Table, pa.Table], Tables]) -> list[tuple[str, ...]]:
    """Kind, file, place and detail of what is found in the training block of a task after a change of its tables."""
    key = BlockKey(1, task, "train")
    (entry,) = whole.manifest.select([task], [1], "train")
    reader = whole.block(entry)
    rows = {name: reader.maps().rows(name) for name in ("scene", "ee_depth", "ee_mask")}
    found: list[tuple[str, ...]] = []
    check_tables(entry, *change(reader.episodes(), reader.steps()), rows, lambda *finding: found.append(finding))
    assert entry.key == key
    return found


def first(table: pa.Table, **wanted: Any) -> int:
    """First row with these values."""
    columns = {name: table[name].to_pylist() for name in wanted}
    return next(row for row in range(len(table)) if all(columns[name][row] == wanted[name] for name in wanted))


def cell(file: str, name: str, value: Any, **wanted: Any) -> Callable[[pa.Table, pa.Table], Tables]:
    """A change of one cell, in the first row with the wanted values. A function is applied to what is there."""

    def change(episodes: pa.Table, steps: pa.Table) -> Tables:
        table = episodes if file == EPISODES else steps
        row = first(table, **wanted)
        new = with_value(table, name, row, value(table[name][row].as_py()) if callable(value) else value)
        return (new, steps) if file == EPISODES else (episodes, new)

    return change


def larger(value: Any) -> Any:
    return value + 1


def varied(**fields: Any) -> str:
    """The column of the first episode, varied."""
    return json.dumps({"axis": "act", "level": 1, "base": 0} | fields, separators=(",", ":"))


DARK = {"seed": 1, "noise_m": -0.1, "edges": 0.0, "block": 1}
CASES = [
    # the labels of an episode and of its steps
    ("grasp", "labels", EPISODES, cell(EPISODES, "success", True, success=False), "success contradicts"),
    ("grasp_push", "labels", EPISODES, cell(EPISODES, "success", True, steps=1), "success contradicts"),
    ("grasp", "labels", EPISODES, cell(EPISODES, "failure", "tool_lost", success=False), "not the last executed"),
    ("grasp", "labels", EPISODES, cell(EPISODES, "failed_step", None, success=False), "failed_step"),
    ("grasp", "labels", EPISODES, cell(EPISODES, "failed_step", 0, success=True), "failed_step"),
    ("push", "labels", STEPS, cell(STEPS, "failure", None, success=False), "has no failure label"),
    ("push", "labels", STEPS, cell(STEPS, "failure", "missed", success=True), "has a failure label"),
    ("push", "labels", STEPS, cell(STEPS, "failure", "tired", success=False), "not one of the schema"),
    ("push", "labels", STEPS, cell(STEPS, "displacement_m", 0.0999, success=True), "moved the object less"),
    ("push", "labels", STEPS, cell(STEPS, "lift_m", -0.1, success=True), "lift_m is negative"),
    ("grasp", "labels", STEPS, cell(STEPS, "lift_m", 0.0, success=True), "did not lift"),
    ("grasp", "labels", STEPS, cell(STEPS, "arm", "middle"), "arm is not one of"),
    # the steps of an episode
    ("grasp_push", "episodes", STEPS, cell(STEPS, "success", False, success=True, last=False), "episode continues"),
    ("grasp_push", "episodes", EPISODES, cell(STEPS, "success", True, success=False, last=False), "ends early"),
    ("grasp_push", "episodes", EPISODES, cell(EPISODES, "steps", 3), "steps is not 1 to 2"),
    ("grasp_push", "episodes", EPISODES, cell(EPISODES, "steps", 1, steps=2), "its episodes have"),
    ("grasp_push", "episodes", EPISODES, cell(EPISODES, "first_step", larger, episode=2), "first_step"),
    ("grasp_push", "episodes", EPISODES, cell(EPISODES, "episode", larger), "do not count from 0"),
    ("grasp_push", "episodes", STEPS, cell(STEPS, "episode", larger), "not those that episodes.parquet has"),
    ("grasp_push", "episodes", STEPS, cell(STEPS, "step", larger), "not those that episodes.parquet has"),
    # actions
    ("grasp", "actions", STEPS, cell(STEPS, "action", larger), "action is not"),
    ("grasp", "actions", STEPS, cell(STEPS, "x_m", lambda x: np.nextafter(x, 1)), "not the pose of the action"),
    ("grasp", "actions", STEPS, cell(STEPS, "theta_rad", lambda x: x + 2 * math.pi), "not the pose of the action"),
    ("grasp", "actions", STEPS, cell(STEPS, "action", int(encode(3, 30, 0))), "outside of the valid square"),
    ("grasp_grasp", "actions", STEPS, cell(STEPS, "action", int(encode(30, 30, 8)), last=True), "above 7"),
    # numbers
    ("grasp", "numbers", STEPS, cell(STEPS, "peak_force_n", math.nan), "peak_force_n is not a finite number"),
    ("grasp", "numbers", STEPS, cell(STEPS, "target_x_m", math.inf), "target_x_m is not a finite number"),
    ("grasp_push", "numbers", STEPS, cell(STEPS, "tool0_z_m", math.nan, last=True), "tool0_z_m is not a finite"),
    ("grasp", "numbers", STEPS, cell(STEPS, "target_width_m", 0.0), "target_width_m is not positive"),
    ("grasp", "numbers", STEPS, cell(STEPS, "target_shape", "X"), "target_shape is not a known shape"),
    ("grasp", "numbers", STEPS, cell(STEPS, "target_shape", "U"), "is not I, L or T, and the episode is clean"),
    ("grasp", "numbers", STEPS, cell(STEPS, "target_arm_m", 0.0, target_shape="L"), "contradicts the shape"),
    ("grasp", "numbers", STEPS, cell(STEPS, "sim_steps", -1), "sim_steps is negative"),
    ("grasp", "numbers", STEPS, cell(STEPS, "policy", None), "policy has no value"),
    # rows of maps
    ("grasp", "rows", STEPS, cell(STEPS, "scene_row", 15), "outside of the 15 rows"),
    ("grasp", "rows", STEPS, cell(STEPS, "ee_row", -1), "outside of the 1 rows"),
    ("grasp", "rows", "maps.zarr/scene", cell(STEPS, "scene_row", larger), "several steps use the map"),
    ("grasp", "rows", "maps.zarr/scene", cell(STEPS, "scene_row", larger), "no step uses the map"),
    ("grasp_push", "rows", "maps.zarr/ee_depth", cell(STEPS, "ee_row", 0, last=True), "no step uses the map"),
    # place
    ("grasp", "place", EPISODES, cell(EPISODES, "split", "val"), "split is not train"),
    ("grasp", "place", STEPS, cell(STEPS, "round", 2), "round is not 1"),
    ("grasp", "place", STEPS, cell(STEPS, "task", "push"), "task is not grasp"),
    ("grasp_push", "place", STEPS, cell(STEPS, "last", True, last=False), "last is wrong"),
    ("grasp_push", "place", STEPS, cell(STEPS, "skill", "push", last=True), "skill is not that"),
    ("grasp_push", "place", STEPS, cell(STEPS, "primitive", "grasp", last=True), "primitive is not that"),
    ("grasp_push", "place", STEPS, cell(STEPS, "embodiment", "gripper", last=True), "embodiment is not that"),
    ("grasp_push", "place", STEPS, cell(STEPS, "policy", "scripted", last=True), "not random, as the manifest says"),
    # tools
    ("grasp_push", "tools", STEPS, cell(STEPS, "tool0_shape", None, last=True), "tool0 is missing"),
    ("grasp_push", "tools", STEPS, cell(STEPS, "tool0_x_m", 0.1, last=False), "nothing was picked yet"),
    ("grasp_push", "tools", STEPS, cell(STEPS, "tool0_length_m", larger, last=True), "not the object that was picked"),
    ("grasp_grasp", "tools", STEPS, cell(STEPS, "tool1_width_m", larger, last=True), "not the object that was picked"),
    ("grasp_grasp", "tools", STEPS, cell(STEPS, "tool0_y_m", larger, last=True), "not as it was at the step before"),
    ("grasp_grasp_push", "tools", STEPS, cell(STEPS, "pinch_height_m", larger, last=True), "not the object"),
    ("grasp", "tools", STEPS, cell(STEPS, "pinch_left_m", 0.1), "nothing was picked yet"),
    # what is varied
    ("push", "variations", EPISODES, cell(EPISODES, "variation", "{"), "cannot be read"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", '{"axis":"act","level":1}'), "cannot be read"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(wind=1)), "cannot be read"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied().replace(",", ", ")), "cannot be read"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(level="1")), "cannot be read"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(level=0)), "no axis and level"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(base=7)), "of another episode"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(seen="0" * 64)), "what is seen"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(world=[["gravity", math.nan]])), "not finite"),
    ("push", "variations", EPISODES, cell(EPISODES, "variation", varied(sense=DARK)), "that cannot be"),
]  # fmt: skip


def test_a_varied_episode_may_have_other_shapes(whole: ReleaseFolder) -> None:
    shape = cell(STEPS, "target_shape", "U", episode=0, target_shape="L")
    described = cell(EPISODES, "variation", varied())
    number = next(row for row in range(15) if findings(whole, "push", shape))  # the first one has an L
    assert number == 0
    assert findings(whole, "push", lambda *tables: described(*shape(*tables))) == []


@pytest.mark.parametrize("task", TASKS)
def test_nothing_is_found_where_nothing_is_wrong(whole: ReleaseFolder, task: str) -> None:
    assert findings(whole, task, lambda episodes, steps: (episodes, steps)) == []


@pytest.mark.parametrize(("task", "kind", "file", "change", "words"), CASES)
def test_contradiction(
    whole: ReleaseFolder, task: str, kind: str, file: str, change: Callable[..., Tables], words: str
) -> None:
    found = findings(whole, task, change)
    kinds = {"numbers", kind} if "negative" in words else {kind}
    assert [item for item in found if item[0] in kinds and item[1] == file and words in item[3]], found


UNCHANGEABLE = {
    EPISODES: ["task", "round", "split", "episode", "first_step", "steps", "success", "failure", "failed_step"],
    STEPS: [
        *("task", "round", "split", "episode", "step", "last", "skill", "primitive", "embodiment", "policy"),
        *("action", "i", "j", "k", "x_m", "y_m", "theta_rad", "success", "failure", "scene_row"),
        *("tool0_shape", "tool0_length_m", "tool1_width_m", "tool1_arm_m"),
    ],
}  # fmt: skip
TEXTS = sorted({"train", "val", "random", "reference", *TASKS, *Failure, "I", "L", "T"})


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_no_single_value_of_these_columns_can_change_unseen(whole: ReleaseFolder, data: st.DataObject) -> None:
    task = data.draw(st.sampled_from(list(TASKS)))
    file = data.draw(st.sampled_from([EPISODES, STEPS]))
    name = data.draw(st.sampled_from(UNCHANGEABLE[file]))

    def change(episodes: pa.Table, steps: pa.Table) -> Tables:
        table = episodes if file == EPISODES else steps
        row = data.draw(st.integers(0, len(table) - 1))
        kind, old = table.schema.field(name).type, table[name][row].as_py()
        if pa.types.is_boolean(kind):
            new: Any = not old
        elif pa.types.is_string(kind):
            new = data.draw(st.sampled_from([text for text in TEXTS if text != old]))
        elif pa.types.is_integer(kind):
            new = data.draw(st.integers(0, 100).filter(lambda value: value != old))
        else:
            new = data.draw(st.floats(0.001, 1.0).filter(lambda value: value != old))
        changed = with_value(table, name, row, new)
        return (changed, steps) if file == EPISODES else (episodes, changed)

    assert findings(whole, task, change)


def test_threshold_of_the_label(whole: ReleaseFolder) -> None:
    """An object that moved far enough was not pushed too little."""

    def change(episodes: pa.Table, steps: pa.Table) -> Tables:
        row = first(steps, success=False)
        episodes = with_value(episodes, "failure", row, Failure.TOO_LITTLE.value)
        steps = with_value(steps, "failure", row, Failure.TOO_LITTLE.value)
        return episodes, with_value(steps, "displacement_m", row, moved)

    moved = np.nextafter(PUSH_SUCCESS_M, 0)
    assert findings(whole, "push", change) == []
    moved = PUSH_SUCCESS_M
    assert "moved 0.1 m or more" in findings(whole, "push", change)[0][3]


def test_threshold_is_that_of_the_world() -> None:
    assert WORLD.push_success_m == PUSH_SUCCESS_M


def test_rows_are_named(whole: ReleaseFolder) -> None:
    def change(episodes: pa.Table, steps: pa.Table) -> Tables:
        return episodes, with_values(steps, "round", [1, 2, 1, *[2] * (len(steps) - 3)])

    ((_, _, where, _),) = findings(whole, "push", change)
    assert where == "13 rows: 1, 3, 4, 5, 6, ..."


def test_contradicting_label_in_a_sealed_file(release: ReleaseFolder) -> None:
    """The manifest fits the bytes, so that only the contents can tell."""
    row = first(release.block(release.manifest.blocks[0]).episodes(), success=True)
    report = verify(change_cell(release, GRASP_TRAIN, EPISODES, "success", row, False))
    assert {finding.file for finding in report.findings} == {
        str(release.root / location(release, GRASP_TRAIN, EPISODES))
    }
    assert {"labels", "counts"} == set(report.counts)
    assert f"row {row}" in {finding.where for finding in report.findings}
    assert not report.damaged
    assert all("bytes are the sealed ones" in finding.fix for finding in report.findings)


def test_manifest_that_counts_otherwise(release: ReleaseFolder) -> None:
    def other(block: BlockEntry) -> BlockEntry:
        return dataclasses.replace(block, end_effectors=9, steps=7) if block.key == GRASP_TRAIN else block

    report = verify(reseal(release, {}, other))
    assert report.counts == {"counts": 4}
    details = {finding.detail for finding in report.findings}
    assert details == {
        "it has 10 steps, the manifest says 7",
        "it has 10 rows, the manifest says 7",
        "it has 1 rows, the manifest says 9",
    }
