"""Which strata make up a batch: exact counts in every batch, or a lottery that is right on average.

A plan numbers batches and draws over the whole training, so that any position can be reached at once.
"""

from __future__ import annotations

import bisect
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from rema_data.samplers.epochs import EpochShape
from rema_data.samplers.row_order import Key, bits, unit_interval
from rema_data.samplers.shares import Shares, as_fractions

__all__ = ["Anchor", "ExactPlan", "LotteryPlan", "Plan", "Quotas"]

Counts = npt.NDArray[np.int64]
"""Draws of every stratum, int64 (strata,)."""
Anchor = tuple[int, list[int]]
"""A number of draws since the start of training, and how many of them each stratum had."""
LONGEST_PERIOD = 4096
"""Batches after which shares that are no simple fractions come out even."""
REPLAY = 2**18
"""Draws of a lottery that are replayed at a time."""


class Plan(Protocol):
    """What a sampler asks about the strata of its batches."""

    shares: Shares
    """What it realises."""

    def labels(self, epoch: int, first: int, stop: int) -> npt.NDArray[np.int16]:
        """Stratum of every draw in batches ``first`` to ``stop`` of one size; int (batches, draws)."""

    def before(self, epoch: int, batch: int) -> Counts:
        """Draws of every stratum since the start of training, before a batch of an epoch."""

    def anchor(self, epoch: int, batch: int) -> Anchor | None:
        """What makes ``before`` quick at or after this position; None where it always is."""

    def restore(self, anchor: Anchor, drawn: int) -> None:
        """Use the anchor of a state after so many draws; raises ValueError where it cannot be one."""


class Quotas:
    """Counts of the strata in batches of one size: within one of their share, in every batch and over time.

    A stratum with the share p gets the whole part of p times the batch in every batch; the draws that are left go to
    the strata that would first fall a whole draw behind. Counts repeat after ``period`` batches.

    Parameters
    ----------
    shares : float64 (strata,)
    batch : int
        Draws in a batch.
    """

    def __init__(self, shares: Shares, batch: int) -> None:
        draws, self.period = as_fractions(shares, batch, LONGEST_PERIOD)
        self._draws = draws
        self._base, self._left = np.divmod(draws, self.period)
        self.shares: Shares = draws / (batch * self.period)

    @cached_property
    def _before(self) -> Counts:
        """Draws before each batch of a period, and at its end; int64 (period + 1, strata)."""
        counts = np.tile(self._base, (self.period + 1, 1))
        counts[0] = 0
        owed = [0] * len(self._left)
        step: list[int] = self._left.tolist()
        strata = [number for number, left in enumerate(step) if left]
        extras = sum(step) // self.period
        for batch in range(1, self.period + 1) if extras else ():
            for stratum in strata:
                owed[stratum] += step[stratum]
            urgency = {s: (owed[s] <= 0, (self.period - owed[s]) / step[s]) for s in strata}
            for stratum in sorted(strata, key=urgency.__getitem__)[:extras]:
                owed[stratum] -= self.period
                counts[batch, stratum] += 1
        total: Counts = np.cumsum(counts, axis=0)
        return total

    def before(self, batch: int) -> Counts:
        """Draws of every stratum before a batch, counted from the first."""
        periods, place = divmod(batch, self.period)
        result: Counts = periods * self._draws + self._before[place]
        return result

    def counts(self, first: int, stop: int) -> Counts:
        """Draws of every stratum in each of some batches, int64 (batches, strata)."""
        places = np.arange(first, stop) % self.period
        result: Counts = self._before[places + 1] - self._before[places]
        return result


class ExactPlan:
    """Every batch has its quotas.

    Parameters
    ----------
    shares : float64 (strata,)
    shape : EpochShape
    alike : bool
        Whether every epoch has the same counts; else fractions of a draw are carried over.
    """

    def __init__(self, shares: Shares, shape: EpochShape, alike: bool = False) -> None:
        self._shape = shape
        self._whole = Quotas(shares, shape.batch)
        self._rest = Quotas(shares, shape.rest) if shape.rest else None
        self._alike = alike
        self.shares = self._whole.shares

    def _numbers(self, epoch: int, batch: int) -> tuple[int, int]:
        """Whole and shorter batches that come before a batch, since the start of training or of an alike epoch."""
        epoch = 0 if self._alike else epoch
        shape = self._shape
        return epoch * shape.whole + min(batch, shape.whole), epoch * (shape.rest > 0) + (batch > shape.whole)

    def labels(self, epoch: int, first: int, stop: int) -> npt.NDArray[np.int16]:
        """See ``Plan``; sorted in every batch."""
        whole, rest = self._numbers(epoch, first)
        if first < self._shape.whole:
            counts = self._whole.counts(whole, whole + stop - first)
        else:
            assert self._rest is not None
            counts = self._rest.counts(rest, rest + 1)
        strata = np.tile(np.arange(counts.shape[1], dtype=np.int16), len(counts))
        return np.repeat(strata, counts.ravel()).reshape(len(counts), -1)

    def before(self, epoch: int, batch: int) -> Counts:
        """See ``Plan``; from the start of the epoch where all are alike."""
        whole, rest = self._numbers(epoch, batch)
        counts = self._whole.before(whole)
        return counts if self._rest is None else counts + self._rest.before(rest)

    def anchor(self, epoch: int, batch: int) -> None:
        """None: any position is quick."""

    def restore(self, anchor: Anchor, drawn: int) -> None:
        """Nothing to do."""


class LotteryPlan:
    """Every draw picks its stratum by itself, with the shares as probabilities: balance on average, as in the paper.

    Parameters
    ----------
    shares : float64 (strata,)
    shape : EpochShape
    key : Key
    """

    def __init__(self, shares: Shares, shape: EpochShape, key: Key) -> None:
        self.shares = shares
        self._shape = shape
        self._key = key
        self._edges = np.cumsum(shares)[:-1]
        self._anchors: list[Anchor] = [(0, [0] * len(shares))]

    def _picks(self, first: int, count: int) -> npt.NDArray[np.int16]:
        chance = unit_interval(bits(self._key, first, count))
        return np.searchsorted(self._edges, chance, side="right").astype(np.int16)

    def labels(self, epoch: int, first: int, stop: int) -> npt.NDArray[np.int16]:
        """See ``Plan``."""
        start, end = self._shape.drawn(epoch, first), self._shape.drawn(epoch, stop)
        return self._picks(start, end - start).reshape(stop - first, -1)

    def before(self, epoch: int, batch: int) -> Counts:
        """See ``Plan``. Draws since the last known position are replayed."""
        drawn = self._shape.drawn(epoch, batch)
        start, known = self.anchor(epoch, batch)
        counts = np.array(known, np.int64)
        while start < drawn:
            step = min(drawn - start, REPLAY)
            counts += np.bincount(self._picks(start, step), minlength=len(counts))
            start += step
        self._keep((drawn, counts.tolist()))
        return counts

    def anchor(self, epoch: int, batch: int) -> Anchor:
        """See ``Plan``: the last position, at or before this one, whose counts are known."""
        drawn = self._shape.drawn(epoch, batch)
        return self._anchors[bisect.bisect_right(self._anchors, drawn, key=lambda anchor: anchor[0]) - 1]

    def restore(self, anchor: Anchor, drawn: int) -> None:
        """See ``Plan``."""
        start, counts = int(anchor[0]), [int(count) for count in anchor[1]]
        if start > drawn or sum(counts) != start or len(counts) != len(self.shares) or min(counts) < 0:
            raise ValueError(f"{anchor} cannot be the counts before draw {drawn}")
        self._keep((start, counts))

    def _keep(self, anchor: Anchor) -> None:
        place = bisect.bisect_left(self._anchors, anchor[0], key=lambda known: known[0])
        if place == len(self._anchors) or self._anchors[place][0] != anchor[0]:
            self._anchors.insert(place, anchor)
