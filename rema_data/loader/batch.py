"""Batches of steps: fixed-point as they come from memory, or float32 in metres as a network takes them."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, SupportsIndex

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import default_collate

from rema_data.errors import InputError
from rema_data.loader.arrays import FloatArrays, StepArrays
from rema_data.loader.convert import to_metres

__all__ = ["Batch", "FloatBatch", "StepBatch", "as_batch"]

Array = npt.NDArray[np.integer[Any] | np.bool_]


class Batch:
    """What both kinds of batch can do: they hold tensors whose first axis is the step.

    The kinds are dataclasses that are not frozen: Lightning sets the fields of a copy when it converts a batch.
    """

    __slots__ = ()
    __match_args__: ClassVar[tuple[str, ...]]

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """The fields, in order."""
        return tuple(getattr(self, name) for name in self.__match_args__)

    def _map(self, function: Callable[[Tensor], Tensor]) -> Self:
        return type(self)(*map(function, self.tensors))

    def __len__(self) -> int:
        return len(self.tensors[0])

    def __getitem__(self, which: SupportsIndex | slice | Sequence[int] | Array | Tensor) -> Self:
        """Some steps of the batch, as a batch: of one step for an integer.

        Raises
        ------
        IndexError
            A step is outside of the batch.
        InputError
            Not a whole number, a slice, a row of whole numbers or a mask with one truth value a step.
        """
        if isinstance(which, slice):
            return self._map(lambda tensor: tensor[which])
        steps = _steps(which)
        if steps.ndim == 0:
            if not -len(self) <= int(steps) < len(self):
                raise IndexError(f"step {int(steps)} is outside of the batch, which has {len(self)}")
            steps = steps[None]
        return self._map(lambda tensor: tensor[steps])

    def replace(self, **tensors: Tensor) -> Self:
        """The batch with some fields replaced, as after an augmentation."""
        return dataclasses.replace(self, **tensors)  # type: ignore[type-var]

    def to(
        self,
        device: torch.device | str | int | torch.dtype | None = None,
        dtype: torch.dtype | None = None,
        *,
        non_blocking: bool = False,
    ) -> Self:
        """The batch on another device, in another floating type, or both; ``to(dtype)`` as of a tensor.

        Every field moves to the device. Only floating ones take the type: in half precision the action 4825 would
        become 4824. A ``StepBatch`` has none: convert what its ``float()`` gives.
        """
        if isinstance(device, torch.dtype):
            device, dtype = None, device
        if dtype is not None and not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
            raise InputError(
                f"a batch cannot be converted to {dtype}",
                hint="give a floating type, for example batch.to(device, torch.bfloat16); other fields keep theirs",
            )
        return self._map(
            lambda tensor: tensor.to(
                tensor.device if device is None else device,
                dtype if tensor.is_floating_point() else None,
                non_blocking=non_blocking,
            )
        )

    def pin_memory(self) -> Self:
        """The batch in page-locked memory, as ``DataLoader(pin_memory=True)`` asks for it."""
        return self._map(Tensor.pin_memory)


@dataclass(slots=True, eq=False)
class StepBatch(Batch):
    """N steps, quantised: 61.5 KB a step.

    Attributes
    ----------
    scene : int16 (N, 64, 64)
        Height above the table in 0.1 mm.
    ee_depth : int16 (N, 2, 112, 112)
        Height of the end effector above its lowest allowed point in 0.1 mm, two states, at yaw 0.
    ee_mask : uint8 (N, 2, 112, 14)
        Whether the topmost body may touch the target, eight pixels of a row in a byte, the first in the highest bit.
    action : int64 (N,)
        Grid index: see ``rema_data.grid``.
    success : bool (N,)
    index : int64 (N,)
        Rows in the dataset's table.
    """

    scene: Tensor
    ee_depth: Tensor
    ee_mask: Tensor
    action: Tensor
    success: Tensor
    index: Tensor

    def float(self) -> FloatBatch:
        """The batch in metres, on the device where it is."""
        scene, end_effector = to_metres(self.scene, self.ee_depth, self.ee_mask)
        return FloatBatch(scene, end_effector, self.action, self.success, self.index)


@dataclass(slots=True, eq=False)
class FloatBatch(Batch):
    """N steps as float32: 217 KB a step.

    Attributes
    ----------
    scene : float32 (N, 1, 64, 64)
        Metres above the table.
    end_effector : float32 (N, 4, 112, 112)
        Depth (m) and mask (0 or 1) of state 1, depth and mask of state 2.
    action : int64 (N,)
        Grid index: see ``rema_data.grid``.
    success : bool (N,)
    index : int64 (N,)
        Rows in the dataset's table.
    """

    scene: Tensor
    end_effector: Tensor
    action: Tensor
    success: Tensor
    index: Tensor

    def float(self) -> FloatBatch:
        """The batch itself, so that a training loop takes both kinds."""
        return self


def as_batch(arrays: StepArrays | FloatArrays) -> StepBatch | FloatBatch:
    """Arrays as a batch of tensors that lie in the same memory."""
    kind = StepBatch if isinstance(arrays, StepArrays) else FloatBatch
    return kind(*map(torch.from_numpy, arrays))


def _steps(which: Any) -> Tensor:
    """A step, or a row of steps or of truth values, as a tensor that indexes as numpy does."""
    try:
        steps = torch.as_tensor(None if isinstance(which, tuple) else which)  # a tuple would mean several axes
    except (TypeError, ValueError, RuntimeError, OverflowError):
        steps = torch.zeros(())
    if not steps.numel() and steps.ndim == 1 and not isinstance(which, Tensor):
        steps = steps.to(torch.int64)  # of an empty list
    truths = steps.dtype == torch.bool
    if steps.is_floating_point() or steps.is_complex() or steps.ndim > 1 or (truths and steps.ndim == 0):
        raise InputError(
            f"{which!r:.80} names no steps of a batch", hint="give a whole number, a slice, or one row of numbers"
        )
    return steps if truths else steps.to(torch.int64)  # bytes would be a mask


def _collate(batch: Any, *, collate_fn_map: Mapping[Any, Any] | None = None) -> Any:
    """Keep a batch that was gathered whole; join several."""
    if isinstance(batch, Batch):
        return batch
    return type(batch[0])(*map(torch.cat, zip(*(part.tensors for part in batch), strict=True)))


# The extension point that torch documents for `default_collate`; the map lies in the module of that function.
sys.modules[default_collate.__module__].default_collate_fn_map.update({StepBatch: _collate, FloatBatch: _collate})
