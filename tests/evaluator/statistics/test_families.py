"""Adjusted p values and letters."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from evaluator.statistics import benjamini_hochberg, holm, tie_letters
from rema_data.errors import InputError

P_VALUES = st.lists(st.floats(0, 1), max_size=30)


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []


def test_benjamini_hochberg_by_hand() -> None:
    assert benjamini_hochberg([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.02, 0.04, 0.04, 0.02])
    assert benjamini_hochberg([]) == []


@given(P_VALUES)
def test_adjusting_never_helps_and_keeps_the_order(p_values: list[float]) -> None:
    family, exploring = holm(p_values), benjamini_hochberg(p_values)
    for before, loose, strict in zip(p_values, exploring, family, strict=True):
        assert before <= loose + 1e-12 and loose <= strict + 1e-12 and strict <= 1
    for first, second in combinations(range(len(p_values)), 2):
        if p_values[first] < p_values[second]:
            assert family[first] <= family[second]


@given(P_VALUES, st.randoms(use_true_random=False))
def test_the_order_of_the_family_does_not_matter(p_values: list[float], random: object) -> None:
    order = list(range(len(p_values)))
    random.shuffle(order)  # type: ignore[attr-defined]
    shuffled = holm([p_values[n] for n in order])
    assert [shuffled[order.index(n)] for n in range(len(order))] == holm(p_values)


@pytest.mark.parametrize("bad", [-0.1, 1.5, float("nan")])
def test_values_that_are_not_p_values(bad: float) -> None:
    for adjust in (holm, benjamini_hochberg):
        with pytest.raises(InputError):
            adjust([0.5, bad])


def test_holm_makes_a_false_claim_in_one_family_of_twenty_at_most() -> None:
    """Of ten hypotheses seven are true; the p values of a family are correlated."""
    generator = np.random.default_rng(3)
    wrong = 0
    for _ in range(2000):
        shared = generator.normal()
        scores = 0.6 * shared + 0.8 * generator.normal(size=10) + np.array([0.0] * 7 + [3.0] * 3)
        adjusted = holm((2 * norm.sf(np.abs(scores))).tolist())
        wrong += min(adjusted[:7]) <= 0.05
    assert wrong < 2000 * 0.06


@pytest.mark.parametrize("false", [0, 3, 8])
def test_of_benjamini_and_hochbergs_claims_one_in_twenty_is_false_at_most(false: int) -> None:
    """Of ten independent hypotheses some are false; where none is, any claim is a false one."""
    generator = np.random.default_rng(4)
    shares = []
    for _ in range(2000):
        scores = generator.normal(size=10) + np.array([0.0] * (10 - false) + [3.0] * false)
        claimed = np.array(benjamini_hochberg((2 * norm.sf(np.abs(scores))).tolist())) <= 0.05
        shares.append(claimed[: 10 - false].sum() / max(claimed.sum(), 1))
    expected = 0.05 * (10 - false) / 10
    assert np.mean(shares) == pytest.approx(expected, abs=3.5 * np.std(shares) / np.sqrt(len(shares)))


@given(
    st.integers(1, 9).flatmap(
        lambda n: st.tuples(st.just(n), st.sets(st.sampled_from(list(combinations(range(n), 2)) or [(0, 0)])))
    )
)
def test_two_share_a_letter_exactly_where_they_do_not_differ(case: tuple[int, set[tuple[int, int]]]) -> None:
    count, pairs = case
    different = {pair for pair in pairs if pair[0] != pair[1]}
    letters = tie_letters(count, different)
    assert len(letters) == count and all(letters)
    for first, second in combinations(range(count), 2):
        assert bool(set(letters[first]) & set(letters[second])) == ((first, second) not in different)
    assert letters[0].startswith("a")


def test_letters_of_a_ladder() -> None:
    assert tie_letters(3, set()) == ["a", "a", "a"]
    assert tie_letters(3, {(0, 2)}) == ["a", "ab", "b"]
    assert tie_letters(3, {(1, 0), (0, 2), (2, 1)}) == ["a", "b", "c"]


def test_more_groups_than_letters() -> None:
    letters = tie_letters(30, set(combinations(range(30), 2)))
    assert letters[25:28] == ["z", "aa", "ab"] and len(set(letters)) == 30
