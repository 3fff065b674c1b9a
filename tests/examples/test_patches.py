"""examples/patches.py: a patch goes where the hand goes, so that what is alike looks alike to a model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from examples.patches import YAWS, candidates, features, mirrored

PRIMITIVES = pytest.mark.parametrize("primitive", ["grasp", "push"])
seeds, angles = st.integers(0, 2**32 - 1), st.integers(0, 15)
inner = st.integers(24, 39)  # places whose patch is inside of the map for both primitives


def scene(seed: int) -> Any:
    """A map in which all heights differ."""
    return np.random.default_rng(seed).random((64, 64), dtype=np.float32)


def one(heights: Any, i: int, j: int, k: int, primitive: str) -> Any:
    return features(heights, np.array([i]), np.array([j]), np.array([k]), primitive)


@PRIMITIVES
@given(seed=seeds, i=inner, j=st.integers(22, 30), k=angles, move=st.integers(-4, 4))
def test_a_patch_moves_with_the_hand(primitive: str, seed: int, i: int, j: int, k: int, move: int) -> None:
    moved = np.roll(scene(seed), (move, -move), axis=(0, 1))
    np.testing.assert_array_equal(one(scene(seed), i, j, k, primitive), one(moved, i + move, j - move, k, primitive))


@given(seed=seeds, i=inner, j=inner, k=angles)
def test_a_patch_turns_with_a_grasp(seed: int, i: int, j: int, k: int) -> None:
    """A quarter turn from +x to +y: column j becomes row j, row i becomes column 63 - i."""
    turned = np.rot90(scene(seed), -1)
    before, after = one(scene(seed), i, j, k, "grasp"), one(turned, j, 63 - i, (k + 4) % 16, "grasp")
    np.testing.assert_array_equal(before[:, :-2], after[:, :-2])


@PRIMITIVES
@given(seed=seeds, i=inner, j=st.integers(20, 30), k=angles)
def test_mirrored_features_are_those_of_the_mirror_image(primitive: str, seed: int, i: int, j: int, k: int) -> None:
    image = one(scene(seed)[::-1], 63 - i, j, -k % 16, primitive)
    np.testing.assert_allclose(mirrored(one(scene(seed), i, j, k, primitive)), image, atol=1e-6)


@PRIMITIVES
def test_one_scene_for_all_is_a_scene_for_each(primitive: str) -> None:
    random = np.random.default_rng(0)
    actions = [random.integers(size, size=50) for size in (64, 64, 16)]
    shared = features(scene(0), *actions, primitive)
    assert shared.shape == (50, 171) and shared.dtype == np.float32
    np.testing.assert_array_equal(shared, features(np.stack([scene(0)] * 50), *actions, primitive))


@PRIMITIVES
def test_candidates_are_valid_and_near_the_object(primitive: str) -> None:
    heights, valid = np.zeros((64, 64), np.float32), np.zeros((64, 64, 16), bool)
    heights[30:34, 30:34] = 0.03
    valid[20:40] = True
    i, j, k = candidates(heights, valid, primitive)
    assert valid[i, j, k].all() and k.max() == YAWS - 1
    assert (np.hypot(i - 31.5, j - 31.5) < 16).all()
    assert len(candidates(np.zeros((64, 64), np.float32), valid, primitive)[0]) == valid[:, :, :YAWS].sum()
