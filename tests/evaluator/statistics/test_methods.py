"""Rates of methods: intervals that cover, pairing that helps, and the same numbers as drawing scenarios one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.statistics import method_difference, method_rate
from rema_data.errors import InputError


def networks(rng: np.random.Generator, rates: list[float], difficulty: np.ndarray) -> np.ndarray:
    """Networks of these rates that find the same scenarios difficult."""
    return np.stack([difficulty + rng.normal(0, 0.1, len(difficulty)) < rate for rate in rates])


def test_the_interval_is_that_of_drawing_scenarios_and_seeds_again() -> None:
    """Against the plain way: every scenario drawn by its number."""
    rng = np.random.default_rng(1)
    solved = networks(rng, [0.3, 0.5, 0.6], rng.random(300))
    found = method_rate(solved, resamples=20_000)
    plain = []
    for _ in range(20_000):
        scenarios, seeds = rng.integers(300, size=300), rng.integers(3, size=3)
        plain.append(solved[:, scenarios].mean(axis=1)[seeds].mean())
    assert found.mean == pytest.approx(solved.mean())
    assert (found.low, found.high) == pytest.approx(np.percentile(plain, [2.5, 97.5]), abs=0.005)
    assert found.by_seed == pytest.approx(solved.mean(axis=1)) and found.scenarios == 300


def test_one_seed_has_the_interval_of_its_scenarios() -> None:
    solved = np.arange(1000)[None] % 4 == 0
    found = method_rate(solved)
    half = 1.96 * (0.25 * 0.75 / 1000) ** 0.5
    assert (found.low, found.high) == pytest.approx((0.25 - half, 0.25 + half), abs=0.003)


def test_a_difference_is_paired() -> None:
    """Two methods that find the same scenarios difficult are told apart better than two that do not."""
    rng = np.random.default_rng(2)
    difficulty = rng.random(2000)
    a, b = networks(rng, [0.55] * 3, difficulty), networks(rng, [0.5] * 3, difficulty)
    paired = method_difference(a, b)
    loose = method_difference(a, b[:, rng.permutation(2000)])
    assert paired.difference == pytest.approx(loose.difference)
    assert paired.high - paired.low < 0.7 * (loose.high - loose.low)
    assert paired.low > 0


def test_improvement_counts_pairs_of_networks() -> None:
    solved = {rate: np.arange(100) < rate for rate in (40, 50, 60)}
    a, b = np.stack([solved[50], solved[60]]), np.stack([solved[40], solved[50]])
    found = method_difference(a, b)
    assert found.improvement == pytest.approx((1 + 0.5 + 1 + 1) / 4)
    assert 0.5 <= found.improvement_low <= found.improvement <= found.improvement_high == 1


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 60), st.integers(0, 2**16))
def test_turned_round_the_sign_changes(seeds_a: int, seeds_b: int, scenarios: int, key: int) -> None:
    rng = np.random.default_rng(key)
    a, b = rng.random((seeds_a, scenarios)) < 0.5, rng.random((seeds_b, scenarios)) < 0.7
    found, turned = method_difference(a, b, resamples=500), method_difference(b, a, resamples=500)
    assert found.difference == pytest.approx(-turned.difference)
    assert found.improvement == pytest.approx(1 - turned.improvement)
    assert found.low <= found.high and found == method_difference(a, b, resamples=500)


@pytest.mark.parametrize("shape", [(3,), (0, 5), (3, 0)])
def test_what_is_no_method_is_named(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="not those of a method"):
        method_rate(np.zeros(shape, bool))


def test_other_scenarios_are_refused() -> None:
    with pytest.raises(InputError, match="on 10 scenarios, method B on 11"):
        method_difference(np.ones((2, 10), bool), np.ones((2, 11), bool))
