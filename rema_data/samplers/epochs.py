"""How long an epoch is, and how it is cut into global batches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.samplers.arguments import one_of, whole
from rema_data.samplers.shares import Shares

__all__ = ["Epoch", "EpochShape", "Tail", "cut_epoch", "draws_of_epoch"]

Tail = Literal["drop", "pad", "short"]
Epoch = Literal["rows", "minority_once", "majority_once"] | int
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class EpochShape:
    """How an epoch is cut into global batches.

    Attributes
    ----------
    batch : int
        Draws in a batch, over all ranks.
    whole : int
        Batches of that size.
    rest : int
        Draws in one more, shorter batch; 0 where there is none.
    """

    batch: int
    whole: int
    rest: int

    @property
    def batches(self) -> int:
        """Batches in an epoch."""
        return self.whole + (self.rest > 0)

    @property
    def draws(self) -> int:
        """Draws in an epoch."""
        return self.whole * self.batch + self.rest

    def drawn(self, epoch: int, batch: int) -> int:
        """Draws since the start of training, before a batch of an epoch."""
        return epoch * self.draws + min(batch * self.batch, self.draws)


def draws_of_epoch(epoch: Epoch, sizes: npt.NDArray[np.int64], shares: Shares) -> int:
    """Draws in an epoch, over all ranks.

    Parameters
    ----------
    epoch : {"rows", "minority_once", "majority_once"} or int
        As many as there are rows; as many as use up the scarcest stratum, or the last one, once; or a number.
    sizes : int64 (strata,)
    shares : float64 (strata,)

    Raises
    ------
    InputError
        It is none of these.
    """
    if not isinstance(epoch, str):
        return whole("epoch", epoch, 1)
    one_of("epoch", epoch, ("rows", "minority_once", "majority_once"))
    if epoch == "rows":
        return int(sizes.sum())
    needed: list[float] = (sizes / shares).tolist()
    if epoch == "minority_once":
        return math.floor(min(needed) + _ROUNDING)
    return math.ceil(max(needed) - _ROUNDING)


def cut_epoch(draws: int, batch: int, tail: Tail, world_size: int) -> EpochShape:
    """Cut an epoch into global batches.

    Raises
    ------
    InputError
        There is no batch, or a shorter one that leaves a rank without rows.
    """
    full, rest = divmod(draws, batch)
    if tail == "pad":
        full, rest = full + (rest > 0), 0
    if tail == "drop":
        rest = 0
    if full + (rest > 0) < 1:
        raise InputError(
            f"an epoch of {draws} draws does not fill one batch of {batch}",
            hint='use a smaller batch, tail="pad" or "short", or a longer epoch (num_samples=...)',
            draws=draws,
        )
    if 0 < rest < world_size:
        raise InputError(
            f"the last batch of an epoch has {rest} rows for {world_size} ranks",
            hint='use tail="drop" or "pad", or another num_samples',
            rest=rest,
        )
    return EpochShape(batch, full, rest)
