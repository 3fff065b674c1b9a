"""Passes over epochs, and where they stand: what makes an order of draws resumable.

A pass takes up where the order stands when its first item is asked for, not when ``iter`` is called: loaders call
``iter`` more than once for one epoch. An epoch that somebody left in the middle is not taken up again, except after
``load_state_dict``: no data is repeated because a loop was left, or because nobody called ``set_epoch``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, Generic, TypeVar

from rema_data.errors import InputError

__all__ = ["Pass", "ResumableOrder"]

Item = TypeVar("Item")


class ResumableOrder(ABC, Generic[Item]):
    """Items in epochs of one length, resumable at any of them."""

    def __init__(self) -> None:
        self._epoch = 0
        self._step = 0  # items handed out in this epoch
        self._started = 0  # step at which the current pass began
        self._resumed = False  # whether the next pass goes on in the middle of the epoch
        self._current: Pass[Item] | None = None

    @abstractmethod
    def __len__(self) -> int:
        """Items in an epoch."""

    @abstractmethod
    def _fetch(self, epoch: int, step: int) -> Any:
        """Some items of an epoch, from ``step`` on; at least one. A list, or an array with an item a row."""

    @abstractmethod
    def _pack(self, epoch: int, step: int) -> dict[str, Any]:
        """State at a position."""

    @abstractmethod
    def _unpack(self, state: dict[str, Any]) -> tuple[int, int]:
        """Epoch and step of a state; raises InputError where the state belongs to something else."""

    @property
    def epoch(self) -> int:
        """The epoch of the current or last pass, from 0."""
        return self._epoch

    @property
    def step(self) -> int:
        """Items handed out in this epoch: with workers, more than a training loop has seen."""
        return self._step

    def __iter__(self) -> Iterator[Item]:
        return Pass(self)

    def set_epoch(self, epoch: int) -> None:
        """Start the next pass with this epoch. Not needed: epochs advance by themselves.

        Where a resumed order stands in the middle of the same epoch, it stays there.
        """
        if epoch < 0:
            raise InputError(f"epoch {epoch} is negative", hint="epochs count from 0")
        if not (self._resumed and epoch == self._epoch):
            self._move(int(epoch), 0, resumed=True)

    def state_dict(self, consumed: int | None = None) -> dict[str, Any]:
        """Where to go on.

        Parameters
        ----------
        consumed : int, optional
            Items that the training loop has taken in the current pass. Needed with torch's own ``DataLoader`` and
            workers, which draws ahead; torchdata's ``StatefulDataLoader`` keeps count by itself. By default, all that
            were handed out.

        Returns
        -------
        dict
            Of plain values: JSON and ``torch.save`` keep it.

        Raises
        ------
        InputError
            So many have not been handed out in this pass.
        """
        step = self._step
        if consumed is not None:
            step = self._started + consumed
            if not self._started <= step <= self._step:
                raise InputError(
                    f"consumed={consumed}, but this pass has handed out {self._step - self._started}",
                    hint="count from the start of the loop over the loader: 1 in its first round",
                )
        return self._pack(self._epoch, step)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where a state says, at a cost that does not grow with the position.

        Raises
        ------
        InputError
            The state belongs to other data, another seed or other settings; the differences are listed.
        """
        self._move(*self._unpack(state), resumed=True)

    def _move(self, epoch: int, step: int, *, resumed: bool, current: Pass[Item] | None = None) -> None:
        self._epoch, self._step, self._started = epoch, step, step
        self._resumed, self._current = resumed, current

    def _next_start(self) -> tuple[int, int]:
        """Epoch and step at which a new pass begins."""
        if self._step == len(self) or (self._step and not self._resumed):
            return self._epoch + 1, 0
        return self._epoch, self._step

    def _begin(self, beginner: Pass[Item]) -> tuple[int, int]:
        start = self._next_start()
        self._move(*start, resumed=False, current=beginner)
        return start


class Pass(Iterator[Item]):
    """One pass over an epoch, or over what is left of it. It has a state of its own, for ``StatefulDataLoader``."""

    def __init__(self, order: ResumableOrder[Item]) -> None:
        self._order = order
        self._epoch = self._step = -1  # not begun
        self._items: Any = ()
        self._place = 0

    def __next__(self) -> Item:
        order = self._order
        if self._place == len(self._items):
            if self._step < 0:
                self._epoch, self._step = order._begin(self)
            if self._step == len(order):
                raise StopIteration
            self._items, self._place = order._fetch(self._epoch, self._step), 0
        item: Item = self._items[self._place]
        self._place += 1
        self._step += 1
        if order._current is self:
            order._step = self._step
        return item

    def state_dict(self) -> dict[str, Any]:
        """Where this pass stands, or will begin."""
        begun = self._step >= 0
        return self._order._pack(*((self._epoch, self._step) if begun else self._order._next_start()))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on exactly where the state says, be it at the end of an epoch."""
        self._epoch, self._step = self._order._unpack(state)
        self._items, self._place = (), 0
        self._order._move(self._epoch, self._step, resumed=False, current=self)
