"""Intervals of one rate against what is known of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import beta, binom, norm

from evaluator.statistics import (
    clopper_pearson,
    error_bounds,
    format_rate,
    percent,
    rate_interval,
    wilson,
    z_against_published,
)
from rema_data.errors import InputError

COUNTS = st.integers(1, 20_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
CONFIDENCES = st.floats(0.5, 0.999)


@given(COUNTS, CONFIDENCES)
def test_wilson_ends_are_where_the_score_test_is_on_the_edge(counts: tuple[int, int], confidence: float) -> None:
    successes, n = counts
    z = norm.ppf(0.5 + confidence / 2)
    for end in wilson(successes, n, confidence):
        if 1e-9 < end < 1 - 1e-9:
            assert abs(successes / n - end) == pytest.approx(z * math.sqrt(end * (1 - end) / n), rel=1e-6, abs=1e-9)


@given(COUNTS, CONFIDENCES)
def test_clopper_pearson_ends_are_beta_quantiles(counts: tuple[int, int], confidence: float) -> None:
    successes, n = counts
    low, high = clopper_pearson(successes, n, confidence)
    tail = (1 - confidence) / 2
    assert low == pytest.approx(beta.ppf(tail, successes, n - successes + 1) if successes else 0.0, rel=1e-6, abs=1e-12)
    assert high == pytest.approx(beta.isf(tail, successes + 1, n - successes) if successes < n else 1.0, rel=1e-6)


@given(COUNTS)
def test_intervals_hold_the_rate_and_mirror(counts: tuple[int, int]) -> None:
    successes, n = counts
    for interval in (wilson, clopper_pearson):
        low, high = interval(successes, n)
        assert 0 <= low <= successes / n <= high <= 1
        assert interval(n - successes, n) == pytest.approx((1 - high, 1 - low), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.floats(0.01, 0.99), st.sampled_from([20, 50, 200]))
def test_clopper_pearson_never_covers_less_than_it_says(rate: float, n: int) -> None:
    covered = sum(binom.pmf(k, n, rate) for k in range(n + 1) if (ends := clopper_pearson(k, n))[0] <= rate <= ends[1])
    assert covered >= 0.95 - 1e-9


@pytest.mark.parametrize(("rate", "n"), [(0.0177, 1000), (0.2, 300), (0.4596, 1000)])
def test_wilson_covers_about_what_it_says(rate: float, n: int) -> None:
    ks = np.flatnonzero(binom.pmf(np.arange(n + 1), n, rate) > 1e-7)
    covered = sum(binom.pmf(k, n, rate) for k in ks if (ends := wilson(int(k), n))[0] <= rate <= ends[1])
    assert 0.935 < covered < 0.97


def test_without_an_episode_the_interval_is_everything() -> None:
    assert wilson(0, 0) == clopper_pearson(0, 0) == rate_interval(0, 0) == (0.0, 1.0)
    assert format_rate(0, 0) == "-"


def test_rates_are_printed_with_one_decimal_and_never_round_to_a_guarantee() -> None:
    assert format_rate(553, 10_000) == "5.5 % [5.1, 6.0]"
    assert format_rate(0, 100) == "0 % [0, 3.6]"
    assert format_rate(10_000, 10_000) == "100 % [99.96, 100]"
    assert format_rate(9_999, 10_000).startswith("99.99 %")


@given(st.floats(0, 1))
def test_only_a_certain_share_prints_as_certain(share: float) -> None:
    text = percent(share)
    assert (text in ("0", "100")) == (share in (0.0, 1.0))
    assert abs(float(text) - 100 * share) <= 0.0501


@given(COUNTS)
def test_the_tables_show_wilson_and_the_guarantee_at_the_ends(counts: tuple[int, int]) -> None:
    successes, n = counts
    ends = successes in (0, n)
    assert rate_interval(successes, n) == (clopper_pearson if ends else wilson)(successes, n)


@given(COUNTS, st.integers(0, 50))
def test_the_bounds_hold_every_way_in_which_lost_episodes_could_have_ended(counts: tuple[int, int], lost: int) -> None:
    successes, measured = counts
    low, high = error_bounds(successes, measured, lost)
    for solved in (0, lost // 2, lost):
        assert low <= (successes + solved) / (measured + lost) <= high
    assert low == pytest.approx(high) if lost == 0 else high - low == pytest.approx(lost / (measured + lost))


def test_bounds_of_nothing() -> None:
    with pytest.raises(InputError):
        error_bounds(0, 0, 0)


@pytest.mark.parametrize(("successes", "n", "confidence"), [(-1, 5, 0.95), (6, 5, 0.95), (1, 5, 0.0), (1, 5, 95.0)])
def test_impossible_counts(successes: int, n: int, confidence: float) -> None:
    with pytest.raises(InputError):
        wilson(successes, n, confidence)


def test_z_of_the_papers_own_comparison() -> None:
    z, p = z_against_published(9353, 10_000, 0.92, 10_000)  # joint against separate, grasp
    assert z == pytest.approx(4.18, abs=0.01) and p == pytest.approx(2.9e-5, rel=0.05)
    assert z_against_published(0, 10, 0.0, 10_000) == (0.0, 1.0)
    with pytest.raises(InputError):
        z_against_published(0, 0, 0.5, 10_000)


@given(COUNTS, st.floats(0.001, 0.999))
def test_z_changes_sign_with_the_roles_of_success_and_failure(counts: tuple[int, int], rate: float) -> None:
    successes, n = counts
    z, p = z_against_published(successes, n, rate, 10_000)
    mirrored, same = z_against_published(n - successes, n, 1 - rate, 10_000)
    assert mirrored == pytest.approx(-z, abs=1e-6) and same == pytest.approx(p, abs=1e-6)
    assert p == pytest.approx(2 * norm.sf(abs(z)), abs=1e-9)


def test_z_is_standard_normal_when_the_rates_are_equal() -> None:
    generator = np.random.default_rng(5)
    ours, theirs = generator.binomial(10_000, 0.3, (2, 2000))
    found = [z_against_published(int(a), 10_000, b / 10_000, 10_000) for a, b in zip(ours, theirs, strict=True)]
    below = sum(p < 0.05 for _, p in found)
    assert 70 < below < 132  # 100 +- 3.3 standard errors
