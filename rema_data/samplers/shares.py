"""How much of the draws each stratum gets."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.samplers.strata import Strata

__all__ = ["Shares", "as_fractions", "shares_of"]

Shares = npt.NDArray[np.float64]
"""Positive, sum 1, float64 (strata,)."""


def shares_of(strata: Strata, wanted: Mapping[Any, float] | None = None) -> Shares:
    """Share of every stratum: equal for the values of the first column, within each for those of the second, etc.

    ``wanted`` has shares of values of the first column in place of equal ones, in any unit; values that it does not
    name have 1. Raises InputError for a value without rows, or a share that is not a positive number.
    """
    given = dict(wanted or {})
    first = {label[0] for label in strata.labels}
    for value, share in given.items():
        if value not in first:
            known = ", ".join(map(str, sorted(first, key=str)))
            raise InputError(
                f"no row has {strata.by[0]}={value}, which is to have a share", hint=f"name some of: {known}"
            )
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 < share < math.inf:
            raise InputError(f"the share of {value} is {share!r}", hint="give a positive number")
    shares = np.array([float(given.get(label[0], 1)) for label in strata.labels])
    for depth in range(1, len(strata.by) + 1):
        siblings = Counter(prefix[:-1] for prefix in {label[:depth] for label in strata.labels})
        for number, label in enumerate(strata.labels):
            shares[number] *= 1 / siblings[label[: depth - 1]]
    return shares / math.fsum(shares)


def as_fractions(shares: Shares, batch: int, period: int) -> tuple[npt.NDArray[np.int64], int]:
    """Shares as whole numbers of draws, int64 (strata,), in a period of at most ``period`` batches, and its length.

    The period is the shortest that is exact, or else the longest, in which a share that is too small becomes zero.
    """
    exact = [Fraction(share).limit_denominator(batch * period) for share in shares.tolist()]
    whole = math.lcm(*(share.denominator for share in exact))
    batches = whole // math.gcd(whole, batch)
    close = all(abs(float(share) - value) < 1e-12 for share, value in zip(exact, shares.tolist(), strict=True))
    if close and sum(exact) == 1 and batches <= period:
        return np.array([int(share * batch * batches) for share in exact], np.int64), batches
    ideal = shares * (batch * period)
    draws = np.floor(ideal).astype(np.int64)
    missing = batch * period - int(draws.sum())
    draws[np.argsort(draws - ideal, kind="stable")[:missing]] += 1  # the largest remainders
    return draws, period
