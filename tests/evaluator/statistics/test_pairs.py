"""Paired comparisons against simulated data whose truth is known, and against published examples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, binomtest, multinomial

from evaluator.statistics import PairTable, detectable_difference, midp_mcnemar, pair_table, paired_interval, wilson
from rema_data.errors import InputError

TABLES = st.tuples(*[st.integers(0, 3000)] * 4).filter(any).map(lambda counts: PairTable(*counts))


def test_the_table_counts_pairs() -> None:
    a = np.array([1, 1, 1, 0, 0, 0, 1], bool)
    b = np.array([1, 0, 0, 1, 0, 0, 1], bool)
    counted = np.array([1, 1, 1, 1, 1, 1, 0], bool)
    assert pair_table(a, b) == PairTable(2, 2, 1, 2)
    table = pair_table(a, b, counted)
    assert table == PairTable(both=1, only_a=2, only_b=1, neither=2)
    assert (table.n, table.rate_a, table.rate_b) == (6, 0.5, pytest.approx(2 / 6))
    assert (table.difference, table.discordance) == (pytest.approx(1 / 6), 0.5)


def test_impossible_tables() -> None:
    with pytest.raises(InputError):
        pair_table(np.ones(3, bool), np.ones(4, bool))
    with pytest.raises(InputError):
        pair_table(np.ones(3, bool), np.ones(3, bool), np.zeros(3, bool))
    with pytest.raises(InputError):
        PairTable(1, -1, 0, 0)


def test_newcombes_example() -> None:
    """Newcombe (1998), the first table of his comparison: 36, 12, 2, 0."""
    assert paired_interval(PairTable(36, 12, 2, 0)) == pytest.approx((0.0569, 0.3404), abs=5e-5)


@given(TABLES)
def test_the_interval_holds_the_difference_and_mirrors(table: PairTable) -> None:
    low, high = paired_interval(table)
    assert -1 <= low <= table.difference <= high <= 1
    swapped = PairTable(table.both, table.only_b, table.only_a, table.neither)
    assert paired_interval(swapped) == pytest.approx((-high, -low), abs=1e-12)


@given(TABLES)
def test_pairing_never_loses_against_independent_runs_that_agree(table: PairTable) -> None:
    """Where outcomes go together, the paired interval is no longer than square-and-add without correlation."""
    if table.both * table.neither <= table.only_a * table.only_b:
        return
    (low_a, high_a), (low_b, high_b) = (wilson(table.both + only, table.n) for only in (table.only_a, table.only_b))
    alone = np.hypot(table.rate_a - low_a, high_b - table.rate_b) + np.hypot(
        high_a - table.rate_a, table.rate_b - low_b
    )
    low, high = paired_interval(table)
    assert high - low <= alone + 1e-12


@pytest.mark.parametrize("cells", [(0.5, 0.1, 0.05, 0.35), (0.9, 0.02, 0.02, 0.06), (0.02, 0.03, 0.01, 0.94)])
def test_the_interval_covers_the_true_difference(cells: tuple[float, ...]) -> None:
    draws = np.random.default_rng([7, int(1000 * cells[1])]).multinomial(500, cells, 400)
    truth = cells[1] - cells[2]
    covered = sum(low <= truth <= high for low, high in (paired_interval(PairTable(*map(int, row))) for row in draws))
    assert 0.92 * len(draws) < covered < 0.98 * len(draws)


@given(TABLES)
def test_midp_is_the_exact_test_less_half_of_what_was_seen(table: PairTable) -> None:
    discordant = table.only_a + table.only_b
    p = midp_mcnemar(table)
    if discordant == 0 or table.only_a == table.only_b:
        assert p == pytest.approx(1.0)
        return
    seen = binom.pmf(table.only_a, discordant, 0.5)
    assert p == pytest.approx(binomtest(table.only_a, discordant, 0.5).pvalue - seen, abs=1e-9)
    swapped = PairTable(table.neither, table.only_b, table.only_a, table.both)
    assert midp_mcnemar(swapped) == pytest.approx(p)


def test_midp_is_a_probability_far_out() -> None:
    """Where it is below the smallest normal number, a difference of tail and table rounds to below zero."""
    tables = [PairTable(0, fewer, more - fewer, 0) for more in range(1000, 1400, 25) for fewer in range(0, 40, 3)]
    found = [midp_mcnemar(table) for table in [*tables, PairTable(7000, 1070, 6, 124), PairTable(0, 10_000, 0, 0)]]
    assert all(0 <= p < 1e-200 for p in found)
    assert max(found) > 0


@pytest.mark.parametrize("discordance", [0.1, 0.3])
def test_midp_rarely_claims_a_difference_that_is_not_there(discordance: float) -> None:
    """Exact: the discordant pairs are binomial, and fall on either side with equal chance."""
    n, wrong = 150, 0.0
    for discordant in range(n + 1):
        weight = binom.pmf(discordant, n, discordance)
        if weight > 1e-5:
            sides = np.arange(discordant + 1)
            tables = [PairTable(0, int(k), discordant - int(k), n - discordant) for k in sides]
            rejected = [midp_mcnemar(table) <= 0.05 for table in tables]
            wrong += weight * binom.pmf(sides, discordant, 0.5)[rejected].sum()
    assert 0.03 < wrong < 0.053


@pytest.mark.parametrize(
    ("discordance", "points"), [(0.01, 0.28), (0.02, 0.40), (0.05, 0.63), (0.1, 0.89), (0.2, 1.25), (0.3, 1.53)]
)
def test_detectable_differences_at_ten_thousand(discordance: float, points: float) -> None:
    """Connor's formula, worked out by hand."""
    found = detectable_difference(10_000, discordance)
    assert found is not None and 100 * found == pytest.approx(points, abs=0.006)


def test_a_detectable_difference_is_found_as_often_as_promised() -> None:
    n, discordance = 2000, 0.1
    difference = detectable_difference(n, discordance)
    assert difference is not None
    cells = (0.5, (discordance + difference) / 2, (discordance - difference) / 2, 0.5 - discordance)
    draws = multinomial(n, cells).rvs(800, random_state=np.random.default_rng(11))
    found = sum(midp_mcnemar(PairTable(*map(int, row))) <= 0.05 for row in draws)
    assert 0.76 * len(draws) < found < 0.84 * len(draws)


@given(st.integers(1, 20_000), st.floats(0, 1))
def test_a_detectable_difference_is_one_that_the_discordance_allows(n: int, discordance: float) -> None:
    found = detectable_difference(n, discordance)
    assert found is None or 0 < found <= discordance
    if found is not None:
        longer = detectable_difference(4 * n, discordance)
        assert longer is not None and longer < found


def test_too_few_discordant_pairs_find_nothing() -> None:
    assert detectable_difference(10_000, 0.0) is None
    assert detectable_difference(100, 0.05) is None
    with pytest.raises(InputError):
        detectable_difference(100, 1.5)
