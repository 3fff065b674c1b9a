"""Sequential tests: a paired e-process, and intervals that hold at every look.

They hold at every number of episodes at once. So you may look after each episode, and stop a run because of what you
see. Pairs must come in an order that does not depend on their outcomes, such as that of a plan. The order in which
workers finish does depend on them: short episodes end differently.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError

__all__ = ["QuickLook", "QuickResult", "difference_sequence", "log_e_value", "rate_sequence"]

ALPHA = 0.05
_NODES, _PANELS = 12, 48
_EDGE = 1e-12

Counts = int | npt.NDArray[np.int64]
Verdict = Literal["better", "worse", "undecided"]


def log_e_value(only_ours: Counts, only_reference: Counts) -> Any:
    """Logarithm of the evidence against equally good policies, from the scenarios that only one of them solved.

    The evidence is the likelihood of the counts, averaged over all chances (a uniform mixture), over their likelihood
    at 1/2. For equally good policies it is a martingale that starts at 1, so the chance that it ever reaches
    ``1 / alpha`` is below alpha (Ville). Takes ints or int64 arrays.
    """
    from scipy.special import betaln

    ours, reference = np.asarray(only_ours), np.asarray(only_reference)
    found = (ours + reference) * math.log(2) + betaln(ours + 1.0, reference + 1.0)
    return float(found) if np.ndim(found) == 0 else found


def rate_sequence(successes: int, n: int, alpha: float = ALPHA) -> tuple[float, float]:
    """Interval of one rate that holds at every n at once with confidence ``1 - alpha`` (uniform mixture).

    Raises
    ------
    InputError
        A count is negative, or alpha is not in (0, 1).
    """
    _check(alpha, successes, n - successes)
    if n == 0:
        return 0.0, 1.0
    from scipy.special import betaln, xlog1py, xlogy

    mixture = float(betaln(successes + 1.0, n - successes + 1.0)) + math.log(alpha)

    def inside(rate: float) -> float:
        return float(xlogy(successes, rate) + xlog1py(n - successes, -rate)) - mixture

    best = successes / n
    return _root(inside, best, 0.0), _root(inside, best, 1.0)


def difference_sequence(only_ours: int, only_reference: int, pairs: int, alpha: float = ALPHA) -> tuple[float, float]:
    """Interval of the difference of two paired rates that holds at every look at once.

    Bets on the paired differences (1, 0 or -1) against every possible mean, mixed uniformly over the sizes of the bet
    (Waudby-Smith and Ramdas 2024). Against a mean of 0 this is the e-process of ``log_e_value``: the interval leaves
    zero exactly when that stops. ``pairs`` includes the concordant ones.

    Returns
    -------
    (low, high) : tuple of float
        Ours minus the reference's, in -1..1.

    Raises
    ------
    InputError
        A count is negative, or alpha is not in (0, 1).
    """
    same = pairs - only_ours - only_reference
    _check(alpha, only_ours, only_reference, same)
    if pairs == 0:
        return -1.0, 1.0

    def high(ours: int, reference: int) -> float:
        """Upper end, for the counts or for the mirrored ones."""
        limit = math.log(2 / alpha)
        best = (ours - reference) / pairs

        def inside(mean: float) -> float:
            # Both directions of the bet, so that zero is inside exactly as long as the e-process runs.
            up, down = _log_wealth(ours, same, reference, mean), _log_wealth(reference, same, ours, -mean)
            return limit - float(np.logaddexp(up, down))

        return _root(inside, best, 1.0)

    return -high(only_reference, only_ours), high(only_ours, only_reference)


def _log_wealth(wins: int, same: int, losses: int, mean: float) -> float:
    """Logarithm of what bets of all admissible sizes that the mean is larger would have made on average."""
    share, log_weight = _quadrature()
    room = max(1 + mean, _EDGE)
    gain, flat = np.log1p(share * (1 - mean) / room), np.log1p(-share * mean / room)
    total = log_weight + wins * gain + same * flat + losses * np.log1p(-share)
    return float(np.logaddexp.reduce(total))


@lru_cache(maxsize=1)
def _quadrature() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Nodes in (0, 1) and logarithms of their weights: Gauss-Legendre on equal panels."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    starts = np.arange(_PANELS)[:, None]
    return ((starts + (nodes + 1) / 2) / _PANELS).ravel(), np.log(np.tile(weights / 2 / _PANELS, _PANELS))


def _root(inside: Callable[[float], float], best: float, edge: float) -> float:
    """Where a function that is positive at ``best`` changes sign on the way to ``edge``; the edge if it does not."""
    from scipy.optimize import brentq

    near = edge + math.copysign(_EDGE, best - edge)
    if abs(best - edge) <= _EDGE or inside(near) >= 0:
        return edge
    return float(brentq(inside, *sorted((best, near)), xtol=1e-10))


def _check(alpha: float, *counts: int) -> None:
    if not 0 < alpha < 1 or any(count < 0 for count in counts):
        raise InputError(f"counts {counts}, alpha {alpha}", hint="give counts from 0 up, and alpha between 0 and 1")


@dataclass(frozen=True, slots=True)
class QuickResult:
    """The result of a quick look; intervals hold at every look."""

    verdict: Verdict  # of our policy against the reference
    alpha: float  # largest chance of a wrong ``better`` or ``worse``, at any number of looks
    pairs: int
    only_ours: int
    only_reference: int
    decided_at: int | None  # pairs after which the verdict was reached; None while undecided
    p_value: float  # anytime-valid: 1 over the largest evidence seen
    rate: float  # ours; NaN without a pair
    rate_interval: tuple[float, float]  # at confidence ``1 - alpha``
    difference: float  # ours minus the reference's; NaN without a pair
    difference_interval: tuple[float, float]  # at confidence ``1 - alpha``

    def to_dict(self) -> dict[str, Any]:
        """The same, ready for JSON."""
        plain = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value for name, value in plain.items()
        }


class QuickLook:
    """A paired sequential test of one policy against a reference: add pairs, stop when it has decided.

    The verdict stays once it is reached; pairs that come later only narrow the intervals. ``alpha`` is the largest
    chance of a verdict where there is no difference.

    Examples
    --------
    >>> look = QuickLook()
    >>> any(look.add(True, False) for _ in range(20))
    True
    >>> look.result().verdict, look.result().decided_at
    ('better', 8)
    """

    def __init__(self, alpha: float = ALPHA) -> None:
        _check(alpha)
        self.alpha = alpha
        self._pairs = self._solved = self._ours = self._reference = 0
        self._largest = 0.0
        self._verdict: Verdict = "undecided"
        self._decided_at: int | None = None

    @property
    def decided(self) -> bool:
        """Whether there is a verdict."""
        return self._decided_at is not None

    def add(self, ours: bool, reference: bool) -> bool:
        """Count one scenario that both were measured on; returns ``decided``.

        Pairs must come in an order that does not depend on outcomes: the plan's, not that of finishing.
        """
        self._pairs += 1
        self._solved += bool(ours)
        if bool(ours) != bool(reference):
            self._ours += bool(ours)
            self._reference += bool(reference)
            evidence = log_e_value(self._ours, self._reference)
            self._largest = max(self._largest, evidence)
            if not self.decided and evidence >= -math.log(self.alpha):
                self._decided_at = self._pairs
                self._verdict = "better" if self._ours > self._reference else "worse"
        return self.decided

    def result(self) -> QuickResult:
        """What the pairs so far say."""
        n, difference = self._pairs, self._ours - self._reference
        return QuickResult(
            verdict=self._verdict,
            alpha=self.alpha,
            pairs=n,
            only_ours=self._ours,
            only_reference=self._reference,
            decided_at=self._decided_at,
            p_value=math.exp(-self._largest),
            rate=self._solved / n if n else math.nan,
            rate_interval=rate_sequence(self._solved, n, self.alpha),
            difference=difference / n if n else math.nan,
            difference_interval=difference_sequence(self._ours, self._reference, n, self.alpha),
        )
