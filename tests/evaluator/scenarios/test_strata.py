"""Strata of targets."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.scenarios.strata import Targets, strata


def targets(count: int, seed: int) -> Targets:
    generator = np.random.default_rng(seed)
    return Targets(
        generator.choice(["I", "L", "T"], count),
        generator.uniform(0.07, 0.13, count),
        generator.uniform(0.02, 0.045, count),
        generator.uniform(0, 2 * math.pi, count),
    )


@given(st.integers(1, 200), st.integers(0, 1000))
def test_every_scenario_is_in_one_stratum_of_each_kind(count: int, seed: int) -> None:
    found = strata(targets(count, seed))
    for by in ("shape", "length", "width", "yaw"):
        members = np.array([stratum.members for stratum in found if stratum.by == by])
        assert np.array_equal(members.sum(axis=0), np.ones(count))
    assert all(stratum.members.any() for stratum in found)


def test_quarters_are_of_one_size_and_in_order() -> None:
    drawn = targets(400, 1)
    found = [stratum for stratum in strata(drawn) if stratum.by == "length"]
    assert [int(stratum.members.sum()) for stratum in found] == [100] * 4
    tops = [drawn.length_m[stratum.members].max() for stratum in found]
    assert tops == sorted(tops) and found[0].label.endswith(" mm")


@pytest.mark.parametrize(
    ("yaw_deg", "label"), [(0, "0 "), (22, "0 "), (23, "45 "), (350, "0 "), (338, "0 "), (180, "180 ")]
)
def test_yaw_bins_are_centred_on_the_axes(yaw_deg: float, label: str) -> None:
    one = Targets(np.array(["I"]), np.array([0.1]), np.array([0.03]), np.array([math.radians(yaw_deg)]))
    (found,) = [stratum for stratum in strata(one) if stratum.by == "yaw"]
    assert found.label.startswith(label)
