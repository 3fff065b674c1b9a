"""How much of the draws each stratum gets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.samplers.strata import Strata, describe_label, label_text

__all__ = ["Shares", "Target", "as_fractions", "target_shares"]

Shares = npt.NDArray[np.float64]
"""Positive, sum 1, float64 (strata,)."""
Target = Literal["uniform", "natural"] | float | Mapping[Any, float]


def target_shares(strata: Strata, target: Target) -> Shares:
    """Share of every stratum in the draws.

    Parameters
    ----------
    strata : Strata
    target : {"uniform", "natural"}, float or mapping
        ``"uniform"`` gives equal shares to the values of the first column, then within each of them to those of the
        second, and so on. ``"natural"`` is by rows. A number between 0 and 1 lies between the two: the weight of a
        value among its neighbours is its rows to that power (0 is uniform, 1 natural). A mapping gives the weight of
        every label (a tuple, or the value itself for one column).

    Raises
    ------
    InputError
        The target is none of these, or a mapping misses, or does not know, a stratum.
    """
    if isinstance(target, Mapping):
        return _from_mapping(strata, target)
    powers = {"uniform": 0.0, "natural": 1.0}
    power = powers.get(target) if isinstance(target, str) else target
    if isinstance(power, bool) or not isinstance(power, int | float) or not 0 <= power <= 1:
        raise InputError(
            f"target={target!r} is no target",
            hint='use "uniform", "natural", a number from 0 (uniform) to 1 (natural), or a weight for every stratum',
        )
    shares = np.ones(len(strata.labels))
    for depth in range(1, len(strata.by) + 1):
        _share_out(shares, strata, depth, float(power))
    return shares / math.fsum(shares)


def _share_out(shares: Shares, strata: Strata, depth: int, power: float) -> None:
    """Multiply in the share that each value of column ``depth`` (from 1) has among its neighbours."""
    rows: dict[tuple[Any, ...], int] = {}
    for label, size in zip(strata.labels, strata.sizes.tolist(), strict=True):
        rows[label[:depth]] = rows.get(label[:depth], 0) + size
    total: dict[tuple[Any, ...], float] = {}
    for prefix, size in rows.items():
        total[prefix[:-1]] = total.get(prefix[:-1], 0.0) + size**power
    for number, label in enumerate(strata.labels):
        shares[number] *= rows[label[:depth]] ** power / total[label[: depth - 1]]


def _from_mapping(strata: Strata, target: Mapping[Any, float]) -> Shares:
    single = len(strata.by) == 1
    weights = {key if isinstance(key, tuple) else (key,): value for key, value in target.items()}
    for label in [*strata.labels, *weights]:
        known, given = label in strata.labels, label in weights
        if not (known and given):
            example = strata.labels[0][0] if single else strata.labels[0]
            raise InputError(
                f"target has no weight for {describe_label(strata.by, label)}"
                if known
                else f"target has a weight for {label!r}, which is no stratum of {', '.join(strata.by)}",
                hint=f"give a weight to each of the {len(strata.labels)} strata, for example {{{example!r}: 0.5, ...}}",
                strata=tuple(label_text(strata.by, stratum) for stratum in strata.labels),
            )
    values = np.array([weights[label] for label in strata.labels], np.float64)
    if not (np.isfinite(values).all() and (values > 0).all()):
        raise InputError(
            "a weight of target is not a positive number",
            hint="leave rows that should not be drawn out of the table",
            target=dict(target),
        )
    return np.asarray(values / math.fsum(values))


def as_fractions(shares: Shares, batch: int, period: int) -> tuple[npt.NDArray[np.int64], int]:
    """Shares as whole numbers of draws in a period of whole batches.

    Parameters
    ----------
    shares : float64 (strata,)
    batch : int
        Draws in a batch.
    period : int
        Most batches in a period.

    Returns
    -------
    draws : int64 (strata,)
        In one period; zero for a share that is too small for the longest period.
    batches : int
        Length of the period: the shortest that is exact, where there is one, else ``period``.
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
    draws[_largest(ideal - draws, missing)] += 1
    return draws, period


def _largest(values: Sequence[float] | Shares, count: int) -> npt.NDArray[np.int64]:
    return np.argsort(-np.asarray(values), kind="stable")[:count]
