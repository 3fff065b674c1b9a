"""One rate: its interval, how to print it, what lost episodes leave open, and the distance to a published rate.

scipy is imported when it is needed: it is slow to load, and the command line shows its help without it.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

from rema_data.errors import InputError

__all__ = [
    "clopper_pearson",
    "difference_interval",
    "error_bounds",
    "format_interval",
    "format_rate",
    "percent",
    "rate_interval",
    "wilson",
    "z_against_published",
]

_MAX_DIGITS = 4


def wilson(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a rate: (low, high), shares in 0..1; (0, 1) without an episode.

    Raises
    ------
    InputError
        The counts are not those of a rate, or the confidence is not in (0, 1).
    """
    return _interval(successes, n, confidence, "wilson")


def clopper_pearson(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson interval, as ``wilson``: never covers less than it says; for guarantees and for zero counts."""
    return _interval(successes, n, confidence, "exact")


def rate_interval(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """The interval that the tables show: Wilson, and Clopper-Pearson for a rate of 0 or 1.

    Readers take such a rate as a guarantee ("it never fails"), so its bound is the one that guarantees.
    """
    return (clopper_pearson if successes in (0, n) else wilson)(successes, n, confidence)


@lru_cache(maxsize=4096)
def _interval(successes: int, n: int, confidence: float, method: Literal["wilson", "exact"]) -> tuple[float, float]:
    if not 0 <= successes <= n:
        raise InputError(f"{successes} successes of {n} episodes", hint="give 0 <= successes <= n")
    if not 0 < confidence < 1:
        raise InputError(f"confidence {confidence}", hint="give a share between 0 and 1, such as 0.95")
    if n == 0:
        return 0.0, 1.0
    from scipy.stats import binomtest

    interval = binomtest(successes, n).proportion_ci(confidence, method)
    return max(0.0, float(interval.low)), min(1.0, float(interval.high))


def difference_interval(
    successes_a: int, n_a: int, successes_b: int, n_b: int, confidence: float = 0.95
) -> tuple[float, float]:
    """Interval of rate A minus rate B over different episodes (Newcombe's, from the two Wilson intervals)."""
    a, b = successes_a / n_a, successes_b / n_b
    (low_a, high_a), (low_b, high_b) = wilson(successes_a, n_a, confidence), wilson(successes_b, n_b, confidence)
    return (a - b - math.hypot(a - low_a, high_b - b), a - b + math.hypot(high_a - a, b - low_b))


def error_bounds(successes: int, measured: int, lost: int) -> tuple[float, float]:
    """The rate if all lost episodes (infrastructure errors) had failed, and if all had succeeded.

    Raises
    ------
    InputError
        The counts are not possible.
    """
    if not 0 <= successes <= measured or lost < 0 or measured + lost == 0:
        raise InputError(
            f"{successes} successes of {measured} episodes, and {lost} lost ones",
            hint="give 0 <= successes <= measured, with one episode at least",
        )
    return successes / (measured + lost), (successes + lost) / (measured + lost)


def percent(share: float) -> str:
    """A share in per cent: one decimal, and more only where it would round to 0 or 100."""
    if share in (0.0, 1.0):
        return f"{100 * share:.0f}"
    for digits in range(1, _MAX_DIGITS + 1):
        text = f"{100 * share + 1e-9:.{digits}f}"
        if float(text) not in (0.0, 100.0):
            break
    return text


def format_interval(interval: tuple[float, float]) -> str:
    """``5.1, 6.0``: the ends of an interval in per cent."""
    low, high = interval
    return f"{percent(low)}, {percent(high)}"


def format_rate(successes: int, n: int, confidence: float = 0.95) -> str:
    """A rate as people should read it: ``5.5 % [5.1, 6.0]``, by ``rate_interval``; ``-`` without an episode."""
    if n == 0:
        return "-"
    return f"{percent(successes / n)} % [{format_interval(rate_interval(successes, n, confidence))}]"


def z_against_published(successes: int, n: int, published_rate: float, published_n: int) -> tuple[float, float]:
    """How far a rate is from a published one, in standard errors (pooled two-proportion test, unpaired).

    ``published_rate`` is a share in 0..1 of ``published_n`` episodes.

    Returns
    -------
    (z, p) : tuple of float
        z > 0 where ours is higher; p is two-sided. (0, 1) where both rates are 0 or both are 1.

    Raises
    ------
    InputError
        The counts or the rate are not possible.
    """
    if not 0 <= successes <= n or n == 0 or published_n < 1 or not 0 <= published_rate <= 1:
        raise InputError(
            f"{successes} of {n} episodes against {published_rate} of {published_n}",
            hint="give 0 <= successes <= n with n > 0, and the published rate as a share in 0..1",
        )
    pooled = (successes + published_rate * published_n) / (n + published_n)
    variance = pooled * (1 - pooled) * (1 / n + 1 / published_n)
    if variance <= 0:
        return 0.0, 1.0
    z = (successes / n - published_rate) / math.sqrt(variance)
    return z, math.erfc(abs(z) / math.sqrt(2))
