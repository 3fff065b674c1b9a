"""Maps and columns survive the way out and back, and actions say where the hand went."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data import grid
from rema_data.convert.layout import (
    from_array,
    obs_of_end_effectors,
    obs_of_scenes,
    stored_end_effectors,
    stored_scenes,
    to_array,
    trajectory,
)
from rema_data.errors import InputError, IntegrityError
from rema_data.schema import TASKS
from rema_data.store.block import BlockKey, encode_episodes
from rema_data.store.columns import STEP_COLUMNS, Column
from rema_data.testing import synthetic_episode

HIGHEST = np.iinfo(np.int16).max
TEXT = Column("failure", "string", "", nullable=True)
NUMBER = Column("pinch_x_m", "float64", "", nullable=True)


@pytest.mark.parametrize("maps", ["metres", "quantised"])
def test_every_height_survives(maps: str) -> None:
    scene = np.arange(HIGHEST + 1, dtype=np.uint16).reshape(8, 64, 64)
    assert np.array_equal(stored_scenes(obs_of_scenes(scene, maps)), scene)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["metres", "quantised"]))
def test_end_effector_maps_survive(seed: int, maps: str) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, HIGHEST, (2, 2, 112, 112), dtype=np.uint16, endpoint=True)
    mask = rng.integers(0, 256, (2, 2, 112, 14), dtype=np.uint8)
    obs = obs_of_end_effectors(depth, mask, maps)
    assert obs.shape == (2, 112, 112, 4)
    back = stored_end_effectors(obs)
    assert np.array_equal(back[0], depth)
    assert np.array_equal(back[1], mask)


def test_maps_are_what_a_policy_sees() -> None:
    steps = synthetic_episode(BlockKey(1, "grasp_push", "train"), 3, success=1.0).steps
    _, _, maps = encode_episodes([synthetic_episode(BlockKey(1, "grasp_push", "train"), 3, success=1.0)])
    scenes = obs_of_scenes(maps.scene, "metres")
    end_effectors = obs_of_end_effectors(maps.ee_depth, maps.ee_mask, "metres")[maps.ee_row]
    for number, step in enumerate(steps):
        assert np.array_equal(scenes[number, ..., 0], step.observation.scene_m())
        assert np.array_equal(end_effectors[number], step.observation.end_effector())


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -1.0, 7.0])
def test_a_height_that_cannot_be_stored_is_refused(wrong: float) -> None:
    obs = np.zeros((1, 64, 64, 1), np.float32)
    obs[0, 3, 4] = wrong
    with pytest.raises(InputError, match="a height is not a number between"):
        stored_scenes(obs)


def test_a_missing_height_and_half_a_mask_are_refused() -> None:
    for value in (65535, HIGHEST + 1):
        with pytest.raises(InputError, match="missing, or above"):
            stored_scenes(np.full((1, 64, 64, 1), value, np.uint16))
    obs = np.zeros((1, 112, 112, 4), np.float32)
    obs[0, 5, 5, 3] = 0.5
    with pytest.raises(InputError, match="other than 0 and 1"):
        stored_end_effectors(obs)


@given(st.integers(0, 50), st.sampled_from(sorted(TASKS)))
def test_actions_lie_in_the_unit_box_and_give_the_grid_index(index: int, task: str) -> None:
    episode = synthetic_episode(BlockKey(1, task, "train"), index, success=0.5)
    _, steps, _ = encode_episodes([episode])
    arrays = trajectory(steps)
    x, y, cosine, sine = arrays["actions"].T.astype(np.float64)
    assert np.abs(arrays["actions"]).max() <= 1
    yaw = np.arctan2(sine, cosine)
    assert np.array_equal(grid.snap(x * grid.SCENE_HALF_M, y * grid.SCENE_HALF_M, yaw), arrays["grid_index"])
    assert arrays["rewards"].tolist() == [0.0] * (len(episode.steps) - 1) + [float(episode.success)]
    assert arrays["dones"].tolist() == [0] * (len(episode.steps) - 1) + [1]


def test_every_column_survives() -> None:
    episodes = [synthetic_episode(BlockKey(1, "grasp_grasp_push", "train"), n, success=0.7) for n in range(20)]
    _, steps, _ = encode_episodes(episodes)
    for column in STEP_COLUMNS:
        back = from_array(to_array(steps[column.name], column), column)
        assert back.equals(steps[column.name].combine_chunks()), column.name


@given(st.lists(st.none() | st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1)))
def test_any_text_survives(texts: list[str | None]) -> None:
    column = pa.chunked_array([pa.array(texts, pa.string())])
    assert from_array(to_array(column, TEXT), TEXT).to_pylist() == texts


@given(st.lists(st.none() | st.floats(allow_nan=False)))
def test_any_number_survives(numbers: list[float | None]) -> None:
    column = pa.chunked_array([pa.array(numbers, pa.float64())])
    assert from_array(to_array(column, NUMBER), NUMBER).equals(column.combine_chunks())


def test_a_value_that_looks_like_none_is_refused() -> None:
    with pytest.raises(IntegrityError, match="failure"):
        to_array(pa.chunked_array([["missed", ""]]), TEXT)
    with pytest.raises(IntegrityError, match="pinch_x_m"):
        to_array(pa.chunked_array([[1.0, float("nan")]]), NUMBER)


@pytest.mark.parametrize(
    ("array", "column"),
    [
        (np.zeros(3, np.float32), NUMBER),
        (np.zeros((3, 1)), NUMBER),
        (np.zeros(3), TEXT),
        (np.array([b"\xff\xfe"]), TEXT),
    ],
)
def test_an_array_of_another_kind_is_no_column(array: np.ndarray, column: Column) -> None:
    with pytest.raises(IntegrityError, match=column.name):
        from_array(array, column)
