"""Phase one of a step: every observation that the policy will need is in the bank before it is asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluator.runner.bank import ObservationBank
from evaluator.runner.config import ProgressSink
from rema_data.schema import Situation

__all__ = ["Batch", "batches", "observe_batches"]

_BLOCK = 512


@dataclass(frozen=True, slots=True)
class Batch:
    """One question to the policy: some rows of one block of the bank.

    Attributes
    ----------
    indices : tuple of int
        Scenario indices.
    block : tuple of Situation
        All situations of the block, which name it in the bank.
    rows : slice
        Of this batch in the block.
    """

    indices: tuple[int, ...]
    block: tuple[Situation, ...]
    rows: slice

    @property
    def situations(self) -> tuple[Situation, ...]:
        """Situations of this batch."""
        return self.block[self.rows]


def batches(alive: Mapping[int, Situation], batch_size: int) -> list[Batch]:
    """The questions of one step: fixed by the order of the scenarios, whatever has been answered before.

    Parameters
    ----------
    alive : mapping of int to Situation
        By scenario index, ascending.
    batch_size : int
    """
    indices, situations = tuple(alive), tuple(alive.values())
    size = batch_size * max(1, _BLOCK // batch_size)
    found = []
    for start in range(0, len(indices), size):
        block = situations[start : start + size]
        for row in range(0, len(block), batch_size):
            rows = slice(row, min(row + batch_size, len(block)))
            found.append(Batch(indices[start + rows.start : start + rows.stop], block, rows))
    return found


def observe_batches(bank: ObservationBank, wanted: Sequence[Batch], progress: ProgressSink) -> None:
    """Put the blocks of ``wanted`` into the bank, one at a time.

    Raises
    ------
    StorageError
        The disk is full or may not be written.
    """
    blocks = list({batch.block: None for batch in wanted})
    progress.phase("observe", sum(len(block) for block in blocks))
    for block in blocks:
        bank.ensure(block)
        progress.advance(len(block))
