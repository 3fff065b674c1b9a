"""Two policies on the same scenarios: the 2x2 table, its test, its interval, and its power."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evaluator.statistics.rates import wilson
from rema_data.errors import InputError

__all__ = ["PairTable", "detectable_difference", "midp_mcnemar", "pair_table", "paired_interval"]

ALPHA = 0.05
POWER = 0.8


@dataclass(frozen=True, slots=True)
class PairTable:
    """Counts of scenarios that both, one or none of two policies solved.

    Raises
    ------
    InputError
        A count is negative, or all are zero.
    """

    both: int
    only_a: int
    only_b: int
    neither: int

    def __post_init__(self) -> None:
        if min(self.both, self.only_a, self.only_b, self.neither) < 0 or self.n == 0:
            raise InputError(
                f"{self} is not a table of pairs", hint="pair at least one scenario that both were measured on"
            )

    @property
    def n(self) -> int:
        """Scenarios."""
        return self.both + self.only_a + self.only_b + self.neither

    @property
    def rate_a(self) -> float:
        """Share that A solved."""
        return (self.both + self.only_a) / self.n

    @property
    def rate_b(self) -> float:
        """Share that B solved."""
        return (self.both + self.only_b) / self.n

    @property
    def difference(self) -> float:
        """A's rate minus B's."""
        return (self.only_a - self.only_b) / self.n

    @property
    def discordance(self) -> float:
        """Share that one solved and the other did not (psi): what decides how much a pair can tell."""
        return (self.only_a + self.only_b) / self.n


def pair_table(
    a: npt.NDArray[np.bool_], b: npt.NDArray[np.bool_], counted: npt.NDArray[np.bool_] | None = None
) -> PairTable:
    """The table of two outcome arrays.

    Parameters
    ----------
    a, b : bool (N,)
        Successes, scenario by scenario.
    counted : bool (N,), optional
        Scenarios that both were measured on; all by default.

    Raises
    ------
    InputError
        The arrays do not have one length, or no scenario is counted.
    """
    if a.shape != b.shape or (counted is not None and counted.shape != a.shape):
        raise InputError(f"outcomes of {len(a)} and {len(b)} scenarios", hint="pair runs over the same scenarios")
    use = np.ones(a.shape, bool) if counted is None else counted
    counts = [int(np.count_nonzero(use & left & right)) for left in (a, ~a) for right in (b, ~b)]
    return PairTable(*counts)


def midp_mcnemar(table: PairTable) -> float:
    """Two-sided mid-p value of McNemar's test, whether one policy solves more scenarios than the other.

    The binomial test of the discordant pairs against 1/2, where the observed table counts half (Fagerland, Lydersen
    and Laake 2013: closer to its level than the exact test, and rarely above it). 1 without a discordant pair.
    """
    discordant = table.only_a + table.only_b
    if discordant == 0:
        return 1.0
    from scipy.stats import binom

    fewer = min(table.only_a, table.only_b)
    # Twice the tail less the table itself, as a sum: far out, a difference of the two rounds to below zero.
    return min(1.0, float(binom.cdf(fewer, discordant, 0.5)) + float(binom.cdf(fewer - 1, discordant, 0.5)))


def paired_interval(table: PairTable, confidence: float = 0.95) -> tuple[float, float]:
    """Newcombe's interval of the difference of paired rates, A minus B (1998, method 10).

    Built from the two Wilson intervals and the correlation of the outcomes; (low, high) in -1..1. It and
    ``midp_mcnemar`` may disagree about zero in borderline cases: the tables decide by the p value.
    """
    n = table.n
    solved_a, solved_b = table.both + table.only_a, table.both + table.only_b
    (low_a, high_a), (low_b, high_b) = wilson(solved_a, n, confidence), wilson(solved_b, n, confidence)
    phi = _correlation(table)
    down_a, up_a = table.rate_a - low_a, high_a - table.rate_a
    down_b, up_b = table.rate_b - low_b, high_b - table.rate_b
    below = math.sqrt(max(0.0, down_a**2 - 2 * phi * down_a * up_b + up_b**2))
    above = math.sqrt(max(0.0, up_a**2 - 2 * phi * up_a * down_b + down_b**2))
    return max(-1.0, table.difference - below), min(1.0, table.difference + above)


def _correlation(table: PairTable) -> float:
    """Newcombe's phi: corrected for continuity where it is positive, 0 where a policy did the same everywhere."""
    n, a, b = table.n, table.both + table.only_a, table.both + table.only_b
    scale = math.sqrt(a * (n - a) * b * (n - b))
    if scale == 0:
        return 0.0
    product = table.both * table.neither - table.only_a * table.only_b
    return (max(product - n / 2, 0.0) if product > 0 else product) / scale


def detectable_difference(n: int, discordance: float, power: float = POWER, alpha: float = ALPHA) -> float | None:
    """The smallest true difference of paired rates that ``n`` scenarios find with this power (Connor 1987).

    Parameters
    ----------
    discordance : float
        Share of scenarios that one policy solves and the other does not; measured, not assumed.
    power, alpha : float
        ``alpha`` is two-sided.

    Returns
    -------
    float or None
        A share in 0..1; None where even the largest difference at this discordance (all pairs on one side) is missed.

    Raises
    ------
    InputError
        An argument is out of range.
    """
    if n < 1 or not 0 <= discordance <= 1 or not 0 < alpha < 1 or not alpha < power < 1:
        raise InputError(
            f"n {n}, discordance {discordance}, power {power}, alpha {alpha}",
            hint="give n >= 1, a discordance in 0..1, and alpha < power < 1",
        )
    from scipy.optimize import brentq
    from scipy.stats import norm

    z_alpha, z_power = float(norm.isf(alpha / 2)), float(norm.isf(1 - power))

    def missing(difference: float) -> float:
        spread = z_alpha * math.sqrt(discordance) + z_power * math.sqrt(max(0.0, discordance - difference**2))
        return spread - difference * math.sqrt(n)

    if missing(discordance) > 0 or discordance == 0:
        return None
    return float(brentq(missing, 0.0, discordance))
