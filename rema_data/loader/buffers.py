"""Large arrays whose memory is used again: allocating new memory costs more than writing into it."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["empty"]

Block = npt.NDArray[np.uint8]

_WORTH_BYTES = 4 << 20
_free: deque[Block] = deque(maxlen=8)
"""Blocks that nothing points to any more; the oldest is given back to the system when there are too many."""


class _Lease:
    """Lends a block to one array, and takes it back when the last view of that array is gone."""

    __slots__ = ("__array_interface__", "_block", "_home")

    def __init__(self, block: Block) -> None:
        self._block, self._home = block, _free
        self.__array_interface__: dict[str, Any] = block.__array_interface__

    def __del__(self) -> None:
        self._home.append(self._block)


def empty(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """As ``numpy.empty``; a large one may lie where one lay of which no array, tensor or view is left."""
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if size < _WORTH_BYTES:
        return np.empty(shape, kind)
    block = _free_block(size)
    return np.asarray(_Lease(np.empty(size, np.uint8) if block is None else block))[:size].view(kind).reshape(shape)


def _free_block(size: int) -> Block | None:
    """A free block of at least ``size`` bytes, and not of much more."""
    for _ in range(len(_free)):
        try:
            block = _free.popleft()  # another thread may have taken the last one
        except IndexError:
            break
        if size <= block.nbytes <= 2 * size:
            return block
        _free.append(block)
    return None
