"""Batches on their way from a worker process: all tensors of a batch in one block of shared memory.

Torch makes one block and one file descriptor for each tensor: for small batches that costs more than their content.
"""

from __future__ import annotations

from collections.abc import Sequence
from multiprocessing.reduction import ForkingPickler
from typing import Any

import torch
from torch import Tensor

from rema_data.loader.batch import Batch, FloatBatch, StepBatch

__all__ = ["pack", "unpack"]

_ALIGN = 64
Place = tuple[torch.dtype, tuple[int, ...], int, int]
"""Type, shape, first and last byte of a tensor."""


def pack(batch: Batch) -> tuple[Any, tuple[Any, ...]]:
    """Reduce a batch to one shared tensor of bytes. For multiprocessing only: ``pickle`` and ``torch.save`` copy."""
    if any(tensor.device.type != "cpu" for tensor in batch.tensors):
        return type(batch), batch.tensors  # torch has its own way to share device memory
    places: list[Place] = []
    end = 0
    for tensor in batch.tensors:
        begin = -(-end // _ALIGN) * _ALIGN
        end = begin + tensor.numel() * tensor.element_size()
        places.append((tensor.dtype, tuple(tensor.shape), begin, end))
    block = torch.empty(end, dtype=torch.uint8).share_memory_()  # type: ignore[no-untyped-call]
    for tensor, part in zip(batch.tensors, _views(block, places), strict=True):
        part.copy_(tensor)
    return unpack, (type(batch), block, places)


def unpack(kind: type[Batch], block: Tensor, places: Sequence[Place]) -> Batch:
    """Inverse of ``pack``: the tensors share the block."""
    return kind(*_views(block, places))


def _views(block: Tensor, places: Sequence[Place]) -> list[Tensor]:
    return [block[begin:end].view(dtype).reshape(shape) for dtype, shape, begin, end in places]


for _kind in (StepBatch, FloatBatch):
    ForkingPickler.register(_kind, pack)
