"""Fixed-point heights: how exact they are, and that nothing else passes for one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from rema_data.errors import InputError, IntegrityError
from rema_data.heights import (
    HEIGHT_ERROR_M,
    HEIGHT_OFFSET_M,
    MISSING,
    decode_heights,
    dequantise,
    encode_heights,
    pack_mask,
    quantise,
    unpack_mask,
)
from rema_data.schema import HEIGHT_STEP_M, Observation

law = settings(max_examples=100, deadline=None)
FLOAT32_SPACING = float(np.spacing(np.float32(3.3)))


@law
@given(st.floats(HEIGHT_OFFSET_M, 3.26))
def test_the_error_is_at_most_half_a_step(height_m: float) -> None:
    stored = quantise(np.array([height_m]))
    assert stored.dtype == np.uint16
    exact = float(stored[0]) * HEIGHT_STEP_M + HEIGHT_OFFSET_M
    assert abs(exact - height_m) <= HEIGHT_ERROR_M * (1 + 1e-9)
    assert abs(float(dequantise(stored)[0]) - height_m) <= HEIGHT_ERROR_M + FLOAT32_SPACING


def test_equal_scenes_are_equal_bytes_in_spite_of_jitter() -> None:
    rng = np.random.default_rng(0)
    heights = rng.integers(0, 600, (64, 64)) * HEIGHT_STEP_M
    jitter = rng.uniform(-4e-5, 4e-5, heights.shape)
    assert quantise(heights).tobytes() == quantise(heights + jitter).tobytes()


def test_small_negative_heights_are_kept() -> None:
    assert dequantise(quantise([-0.01, -0.0003, 0.0])).tolist() == pytest.approx([-0.01, -0.0003, 0.0], abs=1e-9)


@pytest.mark.parametrize("height_m", [np.nan, np.inf, -np.inf, -0.0101, 3.2668, 1e300])
def test_what_is_no_height_is_refused(height_m: float) -> None:
    with pytest.raises(InputError, match="not a number between -0.01 and 3.26"):
        quantise([0.0, height_m])


STEPS = arrays.arrays(np.uint16, st.integers(0, 40), elements=st.integers(0, 32_000))


@law
@given(STEPS)
def test_whole_steps_come_back(steps: np.ndarray) -> None:
    stored = encode_heights(steps)
    assert stored.dtype == np.uint16
    assert decode_heights(stored).tolist() == steps.tolist()
    assert np.array_equal(stored, quantise(steps * HEIGHT_STEP_M))


@law
@given(arrays.arrays(np.uint16, (64, 64), elements=st.integers(0, 3000), fill=st.just(0)))
def test_metres_are_bit_for_bit_what_a_policy_sees(scene: np.ndarray) -> None:
    depth = np.stack([np.resize(scene, (112, 112))] * 2)
    seen = Observation(scene, depth, depth > 0)
    metres = dequantise(encode_heights(scene))
    assert metres.dtype == np.float32
    assert metres.tobytes() == seen.scene_m().tobytes()
    assert np.array_equal(dequantise(encode_heights(depth)), seen.end_effector()[..., [0, 2]].transpose(2, 0, 1))


@pytest.mark.parametrize("steps", [-101, 32_668, 70_000])
def test_steps_out_of_range_are_refused(steps: int) -> None:
    with pytest.raises(InputError, match="out of the range"):
        encode_heights(np.array([0, steps]))


def test_the_range_of_the_format_is_whole() -> None:
    assert encode_heights(np.array([-100, 32_667])).tolist() == [0, 32_767]


def test_a_missing_value_is_never_a_height() -> None:
    stored = encode_heights(np.zeros((3, 4), np.uint16))
    stored[1, 2] = MISSING
    for read in (decode_heights, dequantise):
        with pytest.raises(IntegrityError, match="a value is missing") as caught:
            read(stored)
        assert "rema verify" in caught.value.hint


def test_a_height_beyond_int16_is_no_height() -> None:
    assert decode_heights(np.array([32_767], np.uint16)).tolist() == [32_667]
    with pytest.raises(IntegrityError, match="the value 40000 is not a height"):
        decode_heights(np.array([40_000], np.uint16))


def test_empty_maps_stay_empty() -> None:
    empty = np.empty((0, 64, 64), np.uint16)
    assert dequantise(encode_heights(empty)).shape == quantise(empty).shape == (0, 64, 64)


@law
@given(arrays.arrays(np.bool_, st.tuples(st.integers(0, 3), st.integers(1, 4), st.just(112))))
def test_masks_come_back(mask: np.ndarray) -> None:
    packed = pack_mask(mask)
    assert (packed.dtype, packed.shape) == (np.uint8, (*mask.shape[:-1], 14))
    assert np.array_equal(unpack_mask(packed), mask)


def test_the_first_pixel_is_the_highest_bit() -> None:
    mask = np.zeros(112, bool)
    mask[[0, 9]] = True
    assert pack_mask(mask)[:3].tolist() == [0b1000_0000, 0b0100_0000, 0]
