"""Recycled memory is never lent twice at a time."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rema_data.loader.buffers import _free, empty

LARGE = (8, 1 << 18)


@pytest.fixture(autouse=True)
def nothing_free() -> None:
    _free.clear()


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(["lend", "drop", "tensor", "view"]), st.integers(0, 9)), max_size=25))
def test_living_arrays_keep_their_content(moves: list[tuple[str, int]]) -> None:
    living: list[tuple[object, int]] = []
    for number, (move, which) in enumerate(moves):
        if move == "drop":
            if living:
                living.pop(which % len(living))
            continue
        array = empty(LARGE, np.float32)
        array[:, ::4096] = number
        held: object = array
        if move == "tensor":
            held = torch.from_numpy(array)
        elif move == "view":
            held = torch.from_numpy(array)[3:, 5:]
        del array
        living.append((held, number))
    for held, number in living:
        values = np.asarray(held)
        start = 0 if values.shape == LARGE else -5 % 4096
        assert (values[:, start::4096] == number).all()


def test_memory_is_used_again() -> None:
    first, second = empty(LARGE, np.float32), empty(LARGE, np.float32)
    places = {first.ctypes.data, second.ctypes.data}
    assert len(places) == 2
    view = torch.from_numpy(first)[1:]
    del first, second
    third, fourth = empty(LARGE, np.float32), empty(LARGE, np.float32)
    assert view.data_ptr() not in {third.ctypes.data, fourth.ctypes.data}
    assert len(places & {third.ctypes.data, fourth.ctypes.data}) == 1


def test_what_is_kept_is_bounded() -> None:
    for rows in range(8, 40):
        empty((rows, 1 << 18), np.float32)
    assert len(_free) <= 8


def test_a_smaller_array_fits_into_a_larger_block() -> None:
    large = empty((100, 1 << 18), np.float32)
    place = large.ctypes.data
    del large
    small = empty((90, 1 << 18), np.float32)
    assert small.ctypes.data == place and small.shape == (90, 1 << 18)


def test_small_and_empty_arrays() -> None:
    assert empty((3, 4), np.int16).shape == (3, 4) and empty((0, 64), np.float32).size == 0
