"""Records become rows and come back; a damaged table is never taken for a whole one."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rema_data.errors import IntegrityError, MissingFileError
from rema_data.schema import SCHEMA_VERSION, TASKS, Action, Episode, Situation, skill
from rema_data.store.block import EPISODES, SPLITS, STEPS, BlockKey, encode_episodes
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS
from rema_data.store.tables import (
    action_of,
    outcome_of,
    read_table,
    situation_of,
    step_row,
    to_parquet,
    variation_of,
)
from rema_data.testing import make_block, synthetic_episode

law = settings(max_examples=40, deadline=None)
KEY = BlockKey(1, "grasp_push", "train")
EPISODES_DRAWN = st.builds(
    synthetic_episode,
    st.builds(BlockKey, st.integers(1, 5), st.sampled_from(list(TASKS)), st.sampled_from(SPLITS)),
    st.integers(0, 10_000),
    st.integers(0, 2**64 - 1),
    st.sampled_from([0.0, 0.5, 1.0]),
    st.booleans(),
)


@law
@given(EPISODES_DRAWN)
def test_what_the_simulator_needs_comes_back(episode: Episode) -> None:
    episodes, steps, _ = encode_episodes([episode])
    rows = pq.read_table(pa.BufferReader(to_parquet(steps))).to_pylist()
    assert len(rows) == len(episode.steps)
    for row, step in zip(rows, episode.steps, strict=True):
        assert situation_of(row, episode.variation) == step.situation
        assert action_of(row) == step.action
        left = dataclasses.replace(step.outcome, grip=None, pinch=None)
        assert outcome_of(row) == left
        assert (row["last"], row["skill"]) == (step.situation.last, skill(step.situation.kind))
        assert Action(row["action"]).cell == (row["i"], row["j"], row["k"])
        assert Action(row["action"]).pose == (row["x_m"], row["y_m"], row["theta_rad"])
        assert (row["policy"], row["policy_digest"]) == (step.policy, step.policy_digest)
    (head,) = pq.read_table(pa.BufferReader(to_parquet(episodes))).to_pylist()
    assert (head["task"], head["round"], head["split"]) == (episode.task, episode.round, episode.split)
    assert (head["episode"], head["seed"], head["steps"]) == (episode.index, episode.seed, len(episode.steps))
    assert head["success"] == episode.success
    assert variation_of(head) == episode.variation
    assert head["failure"] == (None if episode.failure is None else episode.failure.value)
    assert head["failed_step"] == (None if episode.success else episode.steps[-1].situation.step)


def test_a_row_has_every_column_that_is_not_null() -> None:
    episode = synthetic_episode(BlockKey(1, "grasp", "train"), 0)
    row = step_row(episode, episode.steps[0], 3, 4)
    names = {column.name for column in STEP_COLUMNS}
    assert set(row) <= names
    assert {column.name for column in STEP_COLUMNS if not column.nullable} <= set(row)
    assert (row["scene_row"], row["ee_row"]) == (3, 4)


def test_tools_stand_only_where_they_are_held() -> None:
    episode = synthetic_episode(BlockKey(1, "grasp_grasp_push", "train"), 1, success=1.0)
    _, steps, _ = encode_episodes([episode])
    for row, step in zip(steps.to_pylist(), episode.steps, strict=True):
        situation: Situation = step.situation
        held = [row[f"{part}_shape"] is not None for part in ("tool0", "tool1", "pinch")]
        assert held == [len(situation.grips) > 0, len(situation.grips) > 1, situation.pinch is not None]


@pytest.fixture
def block(tmp_path: Path) -> Path:
    make_block(tmp_path, KEY, 8)
    return tmp_path


TABLES = pytest.mark.parametrize(("name", "columns"), [(EPISODES, EPISODE_COLUMNS), (STEPS, STEP_COLUMNS)])


@TABLES
def test_a_table_that_is_not_there(name: str, columns: tuple, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="does not exist") as caught:
        read_table(tmp_path / name, columns)
    assert "rema verify" in caught.value.hint


@TABLES
@pytest.mark.parametrize("keep", [0, 1, 4, 100, -1, -8, -200])
def test_a_truncated_table_is_damaged(keep: int, name: str, columns: tuple, block: Path) -> None:
    path = block / name
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(IntegrityError, match="is damaged") as caught:
        read_table(path, columns)
    assert "rema verify" in caught.value.hint
    assert caught.value.facts["path"] == str(path)


def test_a_web_page_is_no_table(block: Path) -> None:
    (block / STEPS).write_text("<!DOCTYPE html><html><body>404 Not Found</body></html>")
    with pytest.raises(IntegrityError, match="is damaged"):
        read_table(block / STEPS, STEP_COLUMNS)


@TABLES
def test_a_flipped_bit_never_changes_a_value(name: str, columns: tuple, block: Path) -> None:
    path = block / name
    data, whole = path.read_bytes(), read_table(path, columns)
    footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    refused = 0
    for place in range(5, len(data), 67):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x80]) + data[place + 1 :])
        try:
            assert read_table(path, columns).equals(whole)
        except IntegrityError:
            refused += place < footer
    assert refused > footer / 67 * 0.8


def test_other_columns_are_named(block: Path) -> None:
    table = read_table(block / STEPS, STEP_COLUMNS)
    pq.write_table(table.drop_columns(["lift_m"]).append_column("weight", table["x_m"]), block / STEPS)
    with pytest.raises(IntegrityError, match=r"other columns \(lift_m, weight\)"):
        read_table(block / STEPS, STEP_COLUMNS)


def test_columns_in_another_order_are_refused(block: Path) -> None:
    table = read_table(block / STEPS, STEP_COLUMNS)
    pq.write_table(table.select(table.column_names[::-1]), block / STEPS)
    with pytest.raises(IntegrityError, match="columns of other types"):
        read_table(block / STEPS, STEP_COLUMNS)


def test_columns_of_other_types_are_refused(block: Path) -> None:
    table = read_table(block / STEPS, STEP_COLUMNS)
    position = table.schema.get_field_index("action")
    pq.write_table(table.set_column(position, "action", table["action"].cast("int64")), block / STEPS)
    with pytest.raises(IntegrityError, match=f"columns of other types than schema version {SCHEMA_VERSION}"):
        read_table(block / STEPS, STEP_COLUMNS)


def test_the_bytes_depend_on_the_rows_alone(block: Path) -> None:
    table = read_table(block / STEPS, STEP_COLUMNS)
    assert to_parquet(table) == (block / STEPS).read_bytes()
    pieces = pa.concat_tables([table.slice(0, 3), table.slice(3)])
    assert to_parquet(pieces.combine_chunks()) == (block / STEPS).read_bytes()
