"""Which row comes next in a stratum: a pure function of (seed, stratum, number of the draw).

Everything is made from the raw 64-bit numbers of Philox, a counter-based generator: its stream is fixed for ever (numpy
promises that for bit generators, not for ``Generator.permutation``), and any position of it can be reached at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Key", "RowOrder", "bits", "shuffled", "stream_key", "unit_interval"]

Key = npt.NDArray[np.uint64]
"""Key of a Philox stream, uint64 (2,)."""
Rows = npt.NDArray[np.signedinteger[Any]]
_LANES = 4  # numbers that Philox makes at one count of its counter


def stream_key(seed: int, *purpose: int) -> Key:
    """Key of a stream of its own for each purpose."""
    return np.random.SeedSequence([seed, *purpose]).generate_state(2, np.uint64).astype(np.uint64, copy=False)


def bits(key: Key, first: int, count: int) -> npt.NDArray[np.uint64]:
    """Numbers ``first`` to ``first + count`` of a stream, uint64 (count,)."""
    counter, skipped = divmod(first, _LANES)
    stream = np.random.Philox(key=key, counter=counter)
    return np.asarray(stream.random_raw(skipped + count)[skipped:])


def unit_interval(raw: npt.NDArray[np.uint64]) -> npt.NDArray[np.float64]:
    """Numbers in [0, 1) from the upper 53 bits."""
    return (raw >> np.uint64(11)).astype(np.float64) * 2.0**-53


def shuffled(keys: npt.NDArray[np.uint64]) -> npt.NDArray[np.int64]:
    """Positions in the order of random keys, along the last axis; int64 of the same shape.

    The lowest bits of every key make way for its position, and numbers are sorted: several times as fast as argsort.
    The bits that are left, 39 for 2^25 keys, are enough for a fair order.
    """
    size = keys.shape[-1]
    places = np.uint64((1 << max(size - 1, 1).bit_length()) - 1)
    packed = keys & ~places
    packed |= np.arange(size, dtype=np.uint64)
    packed.sort(axis=-1)
    packed &= places
    return packed.view(np.int64)


class RowOrder:
    """The order in which the rows of one stratum are drawn: every row once, in a new order each round.

    The order of a round sorts its part of the stream, so reaching any draw costs one sort of the stratum.
    """

    def __init__(self, rows: Rows, key: Key) -> None:
        self._rows = rows
        self._key = key
        self._round = -1
        self._order = rows[:0]  # of that round

    def draw(self, first: int, count: int) -> Rows:
        """Rows of draws ``first`` to ``first + count``, counted since the start of training."""
        size = len(self._rows)
        begin, offset = divmod(first, size)
        end = -(-(first + count) // size)
        fresh = begin + (begin == self._round)
        parts = [self._order] if begin == self._round else []
        if fresh < end:
            keys = bits(self._key, fresh * size, (end - fresh) * size).reshape(end - fresh, size)
            orders = self._rows[shuffled(keys)]
            self._round, self._order = end - 1, orders[-1]
            parts.append(orders.ravel())
        return np.concatenate(parts)[offset : offset + count] if len(parts) > 1 else parts[0][offset : offset + count]
