"""The script that checks the statistics: its exact sums against brute force, and its tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.coverage import coverage, early_stop_level, midp_level
from evaluator.statistics import PairTable, clopper_pearson, midp_mcnemar, rate_interval, wilson
from tests.benchmarks.test_benchmarks import measured


@pytest.mark.parametrize("interval", [wilson, rate_interval, clopper_pearson])
def test_coverage_is_the_sum_over_all_counts(interval: object) -> None:
    n, rates = 30, np.array([0.001, 0.1, 0.5, 0.93])
    found = coverage(interval, n, rates)  # type: ignore[arg-type]
    for rate, held in zip(rates, found, strict=True):
        ends = [interval(k, n) for k in range(n + 1)]  # type: ignore[operator]
        wanted = sum(binom.pmf(k, n, rate) for k, (low, high) in enumerate(ends) if low <= rate <= high)
        assert held == pytest.approx(wanted, abs=1e-12)


def test_the_level_of_the_paired_test_is_the_sum_over_all_tables() -> None:
    n, discordance, wanted = 25, 0.4, 0.0
    for discordant in range(n + 1):
        for only_a in range(discordant + 1):
            if midp_mcnemar(PairTable(0, only_a, discordant - only_a, n - discordant)) <= 0.05:
                wanted += binom.pmf(discordant, n, discordance) * binom.pmf(only_a, discordant, 0.5)
    assert midp_level(n, discordance) == pytest.approx(wanted, abs=1e-8)


def test_the_early_stop_needs_eight_pairs_at_least() -> None:
    """Evidence after m pairs on one side is 2^m / (m + 1): 20 is reached at the eighth."""
    assert early_stop_level(7) == 0.0
    assert early_stop_level(8) == pytest.approx(2 / 2**8)


def test_the_tables(tmp_path: Path) -> None:
    words = ("--sizes", "40,120", "--rates", "19", "--pairs", "120", "--draws", "20")
    numbers = measured(tmp_path, "coverage", *words)["numbers"]
    assert {row["n"] for row in numbers["rates"]} == {40, 120}
    assert all(0.9 < row["least"] <= row["most"] <= 1 for row in numbers["rates"])
    assert 0 < numbers["early_stop_level"] < 0.05
