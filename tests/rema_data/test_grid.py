"""The two-byte action and its metres."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data import grid
from rema_data.errors import InputError, RemaError
from rema_data.schema import (
    Failure,
    Grip,
    ObjectSpec,
    Pinch,
    Shape,
    StepOutcome,
    check_task,
    outcome_from_dict,
    to_dict,
)


@given(st.integers(0, grid.ACTIONS - 1))
def test_index_round_trip(index: int) -> None:
    i, j, k = grid.decode(index)
    assert grid.encode(i, j, k) == index
    assert np.uint16(index) == index


@given(st.integers(4, 59), st.integers(4, 59), st.integers(0, 15))
def test_world_round_trip(i: int, j: int, k: int) -> None:
    index = grid.encode(i, j, k)
    assert grid.snap(*grid.to_world(index)) == index


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-20, 20))
def test_snap_is_nearest_and_inside(x: float, y: float, yaw: float) -> None:
    index = grid.snap(x, y, yaw)
    i, j, _ = grid.decode(index)
    assert grid.inside_valid_square()[i, j]
    sx, sy, syaw = grid.to_world(index)
    half = 56 * grid.PIXEL_M / 2
    for value, snapped in ((x, sx), (y, sy)):
        assert abs(np.clip(value, -half, half) - snapped) <= grid.PIXEL_M / 2 + 1e-12
    assert abs((yaw - syaw + np.pi) % (2 * np.pi) - np.pi) <= np.pi / 16 + 1e-9


def test_rows_grow_with_y_and_columns_with_x() -> None:
    x0, y0, _ = grid.to_world(grid.encode(10, 10, 0))
    x1, y1, _ = grid.to_world(grid.encode(11, 12, 0))
    assert x1 - x0 == pytest.approx(2 * grid.PIXEL_M)
    assert y1 - y0 == pytest.approx(grid.PIXEL_M)


def test_valid_square() -> None:
    assert grid.inside_valid_square().sum() == 56 * 56
    with pytest.raises(ValueError, match="read-only"):
        grid.inside_valid_square()[0, 0] = True


def test_outcome_round_trip() -> None:
    spec = ObjectSpec(Shape.L, 0.1, 0.02, 0.09, 0.03)
    grip = Grip(spec, 0.1, 0.2, 0.3, 0.4, 0.5)
    pinch = Pinch(spec, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    for outcome in (
        StepOutcome(True, None, arm="left", displacement_m=0.1, lift_m=0.2, peak_force_n=3.0, sim_steps=120, grip=grip),
        StepOutcome(True, None, arm="both", pinch=pinch),
        StepOutcome(False, Failure.SLIPPED),
    ):
        assert outcome_from_dict(to_dict(outcome)) == outcome


def test_unknown_task_lists_the_tasks() -> None:
    with pytest.raises(InputError, match="grasp_grasp_push") as caught:
        check_task("juggle")
    assert isinstance(caught.value, RemaError)
    assert isinstance(caught.value, ValueError)
    assert caught.value.facts == {"task": "juggle"}
