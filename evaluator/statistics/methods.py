"""Methods: what a way of training reaches, over training seeds, where a checkpoint is one draw of it.

Intervals are those of a two-level bootstrap: seeds are drawn again, and with them scenarios, the same ones for every
network. With few seeds such an interval is too narrow rather than too wide, because the spread between seeds is
estimated from few of them; say how many there were.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError

__all__ = ["MethodDifference", "MethodRate", "method_difference", "method_rate"]

RESAMPLES = 10_000
_LEVELS = (2.5, 97.5)

Solved = npt.NDArray[np.bool_]
_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MethodRate:
    """Mean success rate over seeds, with its 95 % interval, and the rate of every seed."""

    mean: float
    low: float
    high: float
    by_seed: tuple[float, ...]
    scenarios: int


@dataclass(frozen=True, slots=True)
class MethodDifference:
    """Method A minus method B on the same scenarios, with 95 % intervals.

    ``improvement`` is the probability that a network of A has a higher rate than one of B; equal rates count half.
    """

    difference: float
    low: float
    high: float
    improvement: float
    improvement_low: float
    improvement_high: float


def method_rate(solved: Solved, *, seed: int = 0, resamples: int = RESAMPLES) -> MethodRate:
    """The rate of a method from bool (training seeds, scenarios); an InputError without a seed or a scenario."""
    checked = _checked(solved)
    rng = np.random.default_rng(seed)
    rates = _rates_again(checked, rng, resamples)
    means = np.take_along_axis(rates, _seeds_again(len(checked), rng, resamples), axis=1).mean(axis=1)
    low, high = np.percentile(means, _LEVELS)
    by_seed = checked.mean(axis=1)
    return MethodRate(float(by_seed.mean()), float(low), float(high), tuple(by_seed.tolist()), checked.shape[1])


def method_difference(a: Solved, b: Solved, *, seed: int = 0, resamples: int = RESAMPLES) -> MethodDifference:
    """Compare two methods that were measured on the same scenarios, in the same order.

    Both are bool (training seeds, scenarios); the numbers of seeds may differ. Raises InputError where there is no
    seed or no scenario, or the scenarios are not as many.
    """
    first, second = _checked(a), _checked(b)
    if first.shape[1] != second.shape[1]:
        raise InputError(
            f"method A was measured on {first.shape[1]:,} scenarios, method B on {second.shape[1]:,}",
            hint="compare them on the scenarios that all runs have",
        )
    rng = np.random.default_rng(seed)
    rates = _rates_again(np.concatenate([first, second]), rng, resamples)
    drawn = [
        np.take_along_axis(some, _seeds_again(some.shape[1], rng, resamples), axis=1)
        for some in (rates[:, : len(first)], rates[:, len(first) :])
    ]
    differences = drawn[0].mean(axis=1) - drawn[1].mean(axis=1)
    by_seed = first.mean(axis=1)[None], second.mean(axis=1)[None]
    low, high = np.percentile(differences, _LEVELS)
    improvement_low, improvement_high = np.percentile(_improvement(*drawn), _LEVELS)
    return MethodDifference(
        float(by_seed[0].mean() - by_seed[1].mean()),
        float(low),
        float(high),
        float(_improvement(*by_seed)[0]),
        float(improvement_low),
        float(improvement_high),
    )


def _checked(solved: Solved) -> Solved:
    found = np.asarray(solved, bool)
    if found.ndim != 2 or not found.size:
        raise InputError(
            f"outcomes of shape {found.shape} are not those of a method", hint="give bool (training seeds, scenarios)"
        )
    return found


def _rates_again(solved: Solved, rng: np.random.Generator, resamples: int) -> _Floats:
    """Rates (resamples, networks) over scenarios that are drawn again, the same ones for every network.

    Scenarios that the same networks solved are alike, so it is enough to draw how many there are of each sort.
    """
    sorts, counts = np.unique(solved, axis=1, return_counts=True)
    count = solved.shape[1]
    drawn = rng.multinomial(count, counts / count, size=resamples)
    rates: _Floats = drawn @ sorts.T.astype(np.float64) / count
    return rates


def _seeds_again(count: int, rng: np.random.Generator, resamples: int) -> npt.NDArray[np.int64]:
    return rng.integers(count, size=(resamples, count))


def _improvement(a: _Floats, b: _Floats) -> _Floats:
    """Share of pairs (network of A, network of B) in which A's rate is the higher one, for every row."""
    gap = a[:, :, None] - b[:, None, :]
    share: _Floats = ((gap > 0) + 0.5 * (gap == 0)).mean(axis=(1, 2))
    return share
