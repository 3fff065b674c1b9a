"""Looking early: the chance of a wrong verdict, intervals at every look, and that test and interval agree."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import betaln

from evaluator.statistics import QuickLook, difference_sequence, log_e_value, rate_sequence
from rema_data.errors import InputError

LIMIT = math.log(20)
COUNTS = st.tuples(st.integers(0, 400), st.integers(0, 400), st.integers(0, 2000))


def test_the_evidence_is_an_average_of_likelihood_ratios() -> None:
    for ours, reference in ((0, 0), (1, 0), (5, 2), (30, 41)):
        average, _ = quad(lambda chance, b=ours, c=reference: (2 * chance) ** b * (2 - 2 * chance) ** c, 0, 1)
        assert log_e_value(ours, reference) == pytest.approx(math.log(average), abs=1e-9)
    together = log_e_value(np.array([0, 5]), np.array([0, 2]))
    assert together.tolist() == [log_e_value(0, 0), log_e_value(5, 2)]


def test_the_evidence_stays_where_it_is_on_average_without_a_difference() -> None:
    """Exactly: one more discordant pair leaves the expected evidence as it was."""
    for ours, reference in ((0, 0), (3, 9), (100, 80)):
        after = (log_e_value(ours + 1, reference), log_e_value(ours, reference + 1))
        assert sum(map(math.exp, after)) / 2 == pytest.approx(math.exp(log_e_value(ours, reference)))


def test_a_look_after_every_pair_is_wrong_less_often_than_it_says() -> None:
    """Exactly, by walking through all counts: the share of runs that ever stop within 3,000 discordant pairs."""
    alive, stopped = np.ones(1), 0.0
    for pairs in range(1, 3001):
        alive = (np.append(alive, 0.0) + np.append(0.0, alive)) / 2
        ours = np.arange(pairs + 1)
        crossed = log_e_value(ours, pairs - ours) >= LIMIT
        stopped += alive[crossed].sum()
        alive[crossed] = 0.0
    assert 0.02 < stopped < 0.05
    assert stopped + alive.sum() == pytest.approx(1.0)


def test_quick_looks_at_equal_policies_rarely_decide() -> None:
    generator = np.random.default_rng(2)
    decided = 0
    for _ in range(150):
        look = QuickLook()
        first, second = generator.random((2, 600)) < 0.6
        decided += any(look.add(*pair) for pair in zip(first, second, strict=True))
    assert decided <= 15  # 5 % of 150, and three standard errors


def test_a_clear_difference_is_decided_soon_and_the_right_way_round() -> None:
    generator = np.random.default_rng(4)
    look, count = QuickLook(), 0
    while not look.add(generator.random() < 0.9, generator.random() < 0.05):
        count += 1
    result = look.result()
    assert count < 40 and result.verdict == "better" and result.decided_at == result.pairs == count + 1
    assert result.difference_interval[0] > 0 and result.p_value <= 0.05
    mirrored = QuickLook()
    while not mirrored.add(generator.random() < 0.05, generator.random() < 0.9):
        pass
    assert mirrored.result().verdict == "worse" and mirrored.result().difference_interval[1] < 0


def test_a_verdict_stays() -> None:
    look = QuickLook()
    for _ in range(20):
        look.add(True, False)
    for _ in range(20):
        assert look.add(False, True)
    result = look.result()
    assert (result.verdict, result.decided_at, result.difference) == ("better", 8, 0.0)


def test_before_the_first_pair_nothing_is_known() -> None:
    result = QuickLook().result()
    assert result.verdict == "undecided" and result.decided_at is None and result.p_value == 1.0
    assert result.rate_interval == (0.0, 1.0) and result.difference_interval == (-1.0, 1.0)
    assert result.to_dict()["rate"] is None


@settings(max_examples=60, deadline=None)
@given(COUNTS)
def test_the_interval_leaves_zero_exactly_when_the_test_stops(counts: tuple[int, int, int]) -> None:
    ours, reference, same = counts
    if ours + reference + same == 0:
        return
    evidence = log_e_value(ours, reference)
    low, high = difference_sequence(ours, reference, ours + reference + same)
    assert -1 <= low <= (ours - reference) / (ours + reference + same) <= high <= 1
    if abs(evidence - LIMIT) > 1e-6:
        assert (low > 0 or high < 0) == (evidence > LIMIT)


@pytest.mark.parametrize(("ours", "reference", "pairs"), [(30, 10, 200), (0, 0, 50), (900, 700, 10_000), (7, 7, 14)])
def test_the_ends_of_the_difference_against_plain_integration(ours: int, reference: int, pairs: int) -> None:
    same = pairs - ours - reference
    low, high = difference_sequence(ours, reference, pairs)

    def wealth(mean: float) -> float:
        """The average, over bets of all sizes in both directions, of what they made against this mean."""

        def up(size: float, wins: int, losses: int, mean: float) -> float:
            gain, flat = 1 + size * (1 - mean) / (1 + mean), 1 - size * mean / (1 + mean)
            return math.exp(wins * math.log(gain) + same * math.log(flat) + losses * math.log1p(-size))

        return sum(
            quad(up, 0, 1, args=(wins, losses, sign * mean), limit=500, points=np.linspace(0.01, 0.5, 25))[0] / 2
            for wins, losses, sign in ((ours, reference, 1), (reference, ours, -1))
        )

    for end in (low, high):
        if abs(end) < 1:
            assert wealth(end) == pytest.approx(20, rel=1e-3)


@pytest.mark.parametrize(("both", "ours", "reference"), [(0.5, 0.1, 0.05), (0.9, 0.03, 0.03)])
def test_intervals_hold_at_every_look(both: float, ours: float, reference: float) -> None:
    """A run counts as covered if no look at it, taken after each of many lengths, missed the truth."""
    looks = [20, 50, 100, 200, 400, 800]
    generator, missed_rate, missed_difference, runs = np.random.default_rng(6), 0, 0, 100
    for _ in range(runs):
        cell = generator.choice(4, 800, p=[both, ours, reference, 1 - both - ours - reference])
        counts = [np.bincount(cell[:n], minlength=4).tolist() for n in looks]
        spans = [difference_sequence(b, c, n) for n, (_, b, c, _) in zip(looks, counts, strict=True)]
        missed_difference += any(not low <= ours - reference <= high for low, high in spans)
        rates = [rate_sequence(a + b, n) for n, (a, b, _, _) in zip(looks, counts, strict=True)]
        missed_rate += any(not low <= both + ours <= high for low, high in rates)
    assert missed_rate <= 0.1 * runs and missed_difference <= 0.1 * runs


@given(st.integers(0, 500), st.integers(0, 500))
def test_the_ends_of_a_rate_are_where_the_mixture_has_twenty_times_the_likelihood(
    successes: int, failures: int
) -> None:
    low, high = rate_sequence(successes, successes + failures)
    assert 0 <= low <= high <= 1
    for end in (low, high):
        if 1e-9 < end < 1 - 1e-9:
            likelihood = successes * math.log(end) + failures * math.log1p(-end)
            assert float(betaln(successes + 1, failures + 1)) - likelihood == pytest.approx(LIMIT, abs=1e-4)


def test_arguments_out_of_range() -> None:
    for call in (
        lambda: QuickLook(alpha=0.0),
        lambda: rate_sequence(5, 4),
        lambda: difference_sequence(3, 3, 5),
        lambda: difference_sequence(3, 3, 10, alpha=1.0),
    ):
        with pytest.raises(InputError):
            call()
