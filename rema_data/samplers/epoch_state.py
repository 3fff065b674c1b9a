"""Epochs, and the position in them: what makes an order of batches resumable.

An iterator begins at the position of the order when its first batch is asked for, not when ``iter`` is called: loaders
call ``iter`` more than once for one epoch. An epoch that was left in the middle is not resumed, except after
``load_state_dict``: leaving a loop, or not calling ``set_epoch``, repeats no data.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import InputError
from rema_data.positions import Positions

__all__ = ["Batch", "EpochState", "ResumableOrder"]

Batch = npt.NDArray[np.int64]
"""Rows of the table, int64 (batch_size,)."""


class ResumableOrder(ABC):
    """Batches in epochs of one length, resumable at any of them."""

    def __init__(self) -> None:
        self._epoch = 0
        self._step = 0  # batches handed out in this epoch
        self._started = 0  # step at which the current iterator began
        self._resumed = False  # whether the next iterator continues in the middle of the epoch
        self._current: EpochState | None = None

    @abstractmethod
    def __len__(self) -> int:
        """Batches in an epoch."""

    @abstractmethod
    def _fetch(self, epoch: int, step: int) -> Batch:
        """Some batches of an epoch, from ``step`` on; at least one. int64 (batches, rows)."""

    @abstractmethod
    def _hand_out(self, batch: Batch) -> Positions:
        """A batch as a loader gets it: a list, which every wrapper of samplers can join and cut."""

    @abstractmethod
    def _pack(self, epoch: int, step: int) -> dict[str, Any]:
        """State at a position."""

    @abstractmethod
    def _unpack(self, state: dict[str, Any]) -> tuple[int, int]:
        """Epoch and step of a state; raises InputError where the state belongs to something else."""

    @property
    def epoch(self) -> int:
        """The epoch of the current or last iterator, from 0."""
        return self._epoch

    @property
    def step(self) -> int:
        """Batches handed out in this epoch: with workers, more than a training loop has seen."""
        return self._step

    def __iter__(self) -> Iterator[Positions]:
        return EpochState(self)

    def set_epoch(self, epoch: int) -> None:
        """Start the next iterator with this epoch. Not needed: epochs advance by themselves.

        An order that was resumed in the middle of the same epoch stays there.
        """
        if epoch < 0:
            raise InputError(f"epoch {epoch} is negative", hint="epochs count from 0")
        if not (self._resumed and epoch == self._epoch):
            self._move(int(epoch), 0, resumed=True)

    def state_dict(self, consumed: int | None = None) -> dict[str, Any]:
        """The position, as plain values for JSON or ``torch.save``.

        Parameters
        ----------
        consumed : int, optional
            Batches that the training loop has taken from the current iterator; by default all that were handed out.
            Needed with workers of torch's own ``DataLoader``, which draws ahead; torchdata's ``StatefulDataLoader``
            keeps count.

        Raises
        ------
        InputError
            Fewer batches have been handed out.
        """
        step = self._step
        if consumed is not None:
            step = self._started + consumed
            if not self._started <= step <= self._step:
                raise InputError(
                    f"consumed={consumed}, but this iterator has handed out {self._step - self._started}",
                    hint="count from the start of the loop over the loader: 1 in its first round",
                )
        return self._pack(self._epoch, step)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue at the position of a state; the cost does not grow with the position.

        Raises
        ------
        InputError
            The state belongs to other data, another seed or other settings; the differences are listed.
        """
        self._move(*self._unpack(state), resumed=True)

    def _move(self, epoch: int, step: int, *, resumed: bool, current: EpochState | None = None) -> None:
        self._epoch, self._step, self._started = epoch, step, step
        self._resumed, self._current = resumed, current

    def _next_start(self) -> tuple[int, int]:
        """Epoch and step at which a new iterator begins."""
        if self._step == len(self) or (self._step and not self._resumed):
            return self._epoch + 1, 0
        return self._epoch, self._step

    def _begin(self, beginner: EpochState) -> tuple[int, int]:
        start = self._next_start()
        self._move(*start, resumed=False, current=beginner)
        return start


class EpochState(Iterator[Positions]):
    """Iterator over an epoch, or over what is left of it. It has a state of its own, for ``StatefulDataLoader``."""

    def __init__(self, order: ResumableOrder) -> None:
        self._order = order
        self._epoch = self._step = -1  # not begun
        self._fetched: Any = ()
        self._place = 0

    def __next__(self) -> Positions:
        order = self._order
        if self._place == len(self._fetched):
            if self._step < 0:
                self._epoch, self._step = order._begin(self)
            if self._step == len(order):
                raise StopIteration
            self._fetched, self._place = order._fetch(self._epoch, self._step), 0
        batch = order._hand_out(self._fetched[self._place])
        self._place += 1
        self._step += 1
        if order._current is self:
            order._step = self._step
        return batch

    def state_dict(self) -> dict[str, Any]:
        """The position of this iterator, or where it will begin."""
        begun = self._step >= 0
        return self._order._pack(*((self._epoch, self._step) if begun else self._order._next_start()))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly at the position of a state, also at the end of an epoch."""
        self._epoch, self._step = self._order._unpack(state)
        self._fetched, self._place = (), 0
        self._order._move(self._epoch, self._step, resumed=False, current=self)
