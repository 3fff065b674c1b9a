"""Blocks: the same bytes however they were cut, and end-effector maps stored once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data.errors import InputError
from rema_data.heights import dequantise, unpack_mask
from rema_data.schema import TASKS, Episode
from rema_data.store.block import SPLITS, BlockKey, BlockReader, BlockWriter, encode_episodes
from rema_data.testing import make_block, synthetic_episode

KEY = BlockKey(1, "grasp_grasp", "val")


def written(folder: Path, episodes: list[Episode], cuts: list[int]) -> dict[str, bytes]:
    """Files of a block that was written in pieces."""
    writer = BlockWriter(folder)
    for start, stop in zip([0, *cuts], [*cuts, len(episodes)], strict=True):
        writer.append(*encode_episodes(episodes[start:stop]))
    writer.close()
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_bytes_do_not_depend_on_the_cut(tmp_path: Path) -> None:
    episodes = [synthetic_episode(KEY, index) for index in range(9)]
    whole = written(tmp_path / "whole", episodes, [])
    assert len(whole) == 2 + 1 + 3 * 2
    for number, cuts in enumerate(([4], [1, 2, 8], list(range(1, 9)), [0, 5, 5])):
        assert written(tmp_path / str(number), episodes, cuts) == whole


def test_rows_point_at_the_maps_of_their_step(tmp_path: Path) -> None:
    episodes = [synthetic_episode(KEY, index) for index in range(6)]
    written(tmp_path, episodes, [1, 3])
    reader = BlockReader(tmp_path)
    steps, heads, maps = reader.steps().to_pylist(), reader.episodes().to_pylist(), reader.maps()
    scene, depth, mask = (maps.read(name, 0, maps.rows(name)) for name in ("scene", "ee_depth", "ee_mask"))
    for head, episode in zip(heads, episodes, strict=True):
        rows = steps[head["first_step"] : head["first_step"] + head["steps"]]
        assert len(rows) == len(episode.steps)
        for row, step in zip(rows, episode.steps, strict=True):
            seen = step.observation
            assert (row["episode"], row["step"]) == (episode.index, step.situation.step)
            assert np.array_equal(dequantise(scene[row["scene_row"]]), seen.scene_m())
            planes = seen.end_effector().transpose(2, 0, 1)
            assert np.array_equal(dequantise(depth[row["ee_row"]]), planes[0::2])
            assert np.array_equal(unpack_mask(mask[row["ee_row"]]), seen.mask)


def test_equal_end_effectors_are_stored_once(tmp_path: Path) -> None:
    episodes = [synthetic_episode(KEY, index) for index in range(6)]
    written(tmp_path, episodes, [2, 4])
    reader = BlockReader(tmp_path)
    maps, rows = reader.maps(), reader.steps()["ee_row"].to_numpy()
    depth = maps.read("ee_depth", 0, maps.rows("ee_depth"))
    mask = maps.read("ee_mask", 0, maps.rows("ee_mask"))
    different = {a.tobytes() + b.tobytes() for a, b in zip(depth, mask, strict=True)}
    assert len(different) == len(depth) == len(mask) < len(rows)
    assert sorted(set(rows)) == list(range(len(depth)))


def test_maps_that_differ_in_the_mask_alone_are_kept_apart(tmp_path: Path) -> None:
    first, second = (synthetic_episode(BlockKey(1, "grasp", "train"), index) for index in range(2))
    second.steps[0].observation.mask[0, 0, 0] ^= True
    written(tmp_path, [first, second], [])
    assert BlockReader(tmp_path).maps().rows("ee_depth") == 2


def test_an_empty_piece_adds_nothing(tmp_path: Path) -> None:
    make_block(tmp_path, KEY, 1)
    episodes, steps, maps = encode_episodes([])
    assert (episodes.num_rows, steps.num_rows, len(maps.scene), len(maps.ee_depth)) == (0, 0, 0, 0)
    assert maps.ee_depth.shape[1:] == (2, 112, 112)


@given(st.integers(1, 10**6), st.sampled_from(list(TASKS)), st.sampled_from(SPLITS))
def test_the_path_of_a_block_names_it(number: int, task: str, split: str) -> None:
    key = BlockKey(number, task, split)
    assert BlockKey.parse(key.path) == key


@pytest.mark.parametrize(
    "path",
    [
        "",
        "round-1",
        "round-1/grasp",
        "round-1/grasp/test",
        "round-0/grasp/train",
        "round-01/grasp/train",
        "round--1/grasp/train",
        "round-²/grasp/train",
        "round-1/juggle/train",
        "round-1/grasp/train/steps.parquet",
        "../round-1/grasp/train",
        "1/grasp/train",
    ],
)
def test_what_names_no_block(path: str) -> None:
    with pytest.raises(InputError, match="is not the name of a block") as caught:
        BlockKey.parse(path)
    assert "round-1/grasp/train" in caught.value.hint


def test_a_height_out_of_range_is_not_stored() -> None:
    episode = synthetic_episode(BlockKey(1, "grasp", "train"), 0)
    episode.steps[0].observation.scene[3, 3] = 65_500
    with pytest.raises(InputError, match="out of the range"):
        encode_episodes([episode])
