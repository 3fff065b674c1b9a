"""Which strata make up a batch: exact counts in every batch, or a lottery that is right on average.

A plan numbers batches over the whole training, so that any position can be reached at once.
"""

from __future__ import annotations

import bisect
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from rema_data.samplers.row_order import Key, bits, unit_interval
from rema_data.samplers.shares import Shares, as_fractions

__all__ = ["Anchor", "BatchPlan", "ExactPlan", "LotteryPlan"]

Counts = npt.NDArray[np.int64]
"""Draws of every stratum, int64 (strata,)."""
Anchor = tuple[int, list[int]]
"""A number of draws since the start of training, and how many of them each stratum had."""
LONGEST_PERIOD = 4096
"""Batches after which shares that are not simple fractions are met exactly."""
REPLAY = 2**18
"""Draws of a lottery that are replayed at a time."""


class BatchPlan(Protocol):
    """What a sampler asks about the strata of its global batches, counted since the start of training."""

    shares: Shares
    """Of the strata, as the plan realises them."""

    def labels(self, first: int, stop: int) -> npt.NDArray[np.int16]:
        """Stratum of every draw in batches ``first`` to ``stop``; int (batches, draws)."""

    def before(self, batch: int) -> Counts:
        """Draws of every stratum before a batch."""

    def anchor(self, batch: int) -> Anchor | None:
        """What makes ``before`` quick at or after this position; None where it always is."""

    def restore(self, anchor: Anchor, batch: int) -> None:
        """Use the anchor of a state at this batch; raises ValueError where it cannot be one."""


class ExactPlan:
    """Every batch has its counts: within one of the shares, in every batch and over time.

    A stratum with the share p gets the whole part of p times the batch in every batch; the draws that are left go to
    the strata that would first fall a whole draw behind. Counts repeat after ``period`` batches.
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

    def labels(self, first: int, stop: int) -> npt.NDArray[np.int16]:
        """See ``BatchPlan``; sorted in every batch."""
        places = np.arange(first, stop) % self.period
        counts = self._before[places + 1] - self._before[places]
        strata = np.tile(np.arange(counts.shape[1], dtype=np.int16), len(counts))
        return np.repeat(strata, counts.ravel()).reshape(len(counts), -1)

    def before(self, batch: int) -> Counts:
        """See ``BatchPlan``."""
        periods, place = divmod(batch, self.period)
        result: Counts = periods * self._draws + self._before[place]
        return result

    def anchor(self, batch: int) -> None:
        """None: any position is quick."""

    def restore(self, anchor: Anchor, batch: int) -> None:
        """Nothing to do."""


class LotteryPlan:
    """Every draw picks its stratum by itself, with the shares as probabilities: balance on average, as in the paper."""

    def __init__(self, shares: Shares, batch: int, key: Key) -> None:
        self.shares = shares
        self._batch = batch
        self._key = key
        self._edges = np.cumsum(shares)[:-1]
        self._anchors: list[Anchor] = [(0, [0] * len(shares))]

    def _picks(self, first: int, count: int) -> npt.NDArray[np.int16]:
        chance = unit_interval(bits(self._key, first, count))
        return np.searchsorted(self._edges, chance, side="right").astype(np.int16)

    def labels(self, first: int, stop: int) -> npt.NDArray[np.int16]:
        """See ``BatchPlan``."""
        return self._picks(first * self._batch, (stop - first) * self._batch).reshape(stop - first, -1)

    def before(self, batch: int) -> Counts:
        """See ``BatchPlan``. Draws since the last known position are replayed."""
        drawn = batch * self._batch
        start, known = self.anchor(batch)
        counts = np.array(known, np.int64)
        while start < drawn:
            step = min(drawn - start, REPLAY)
            counts += np.bincount(self._picks(start, step), minlength=len(counts))
            start += step
        self._keep((drawn, counts.tolist()))
        return counts

    def anchor(self, batch: int) -> Anchor:
        """See ``BatchPlan``: the last position, at or before this one, whose counts are known."""
        drawn = batch * self._batch
        return self._anchors[bisect.bisect_right(self._anchors, drawn, key=lambda anchor: anchor[0]) - 1]

    def restore(self, anchor: Anchor, batch: int) -> None:
        """See ``BatchPlan``."""
        start, counts = int(anchor[0]), [int(count) for count in anchor[1]]
        if start > batch * self._batch or sum(counts) != start or len(counts) != len(self.shares) or min(counts) < 0:
            raise ValueError(f"{anchor} cannot be the counts before batch {batch}")
        self._keep((start, counts))

    def _keep(self, anchor: Anchor) -> None:
        place = bisect.bisect_left(self._anchors, anchor[0], key=lambda known: known[0])
        if place == len(self._anchors) or self._anchors[place][0] != anchor[0]:
            self._anchors.insert(place, anchor)
