"""How far a training is: a bar with the running loss, and a line for every validation."""

from __future__ import annotations

import time
from typing import Any

from torch import Tensor

from rema_data.progress import Progress

__all__ = ["TrainingReport"]

_READ_EVERY = 20
"""Updates between two looks at the loss: each look waits until the device has done all that it was told."""


class TrainingReport:
    """Reports the training ``what``, of so many updates, to a ``Progress``."""

    def __init__(self, progress: Progress, what: str, updates: int) -> None:
        self._progress, self._what, self._updates = progress, what, updates
        progress.phase(what, updates)
        self._begin()

    def _begin(self) -> None:
        self._losses: list[Tensor] = []
        self._samples, self._since = 0, time.perf_counter()

    def resumed(self, update: int, threads: list[int]) -> None:
        """An interrupted training goes on after an update; ``threads``: how many it had so far."""
        counts = " and ".join(map(str, threads))
        mixed = f"; with {counts} threads, so not to the weights that one number of them gives"
        words = f"{self._what}: resumed after update {update:,} of {self._updates:,}"
        self._progress.note(words + (mixed if len(threads) > 1 else ""))
        self._progress.resume(update)
        self._begin()

    def updated(self, loss: Tensor, samples: int) -> None:
        """An update is done; ``loss`` is still on the device."""
        self._progress.advance(1)
        self._losses.append(loss)
        self._samples += samples
        if len(self._losses) >= _READ_EVERY:
            mean = float(sum(self._losses[1:], self._losses[0])) / len(self._losses)
            speed = self._samples / (time.perf_counter() - self._since)
            self._progress.tell(f"loss {mean:.3f}, {speed:,.0f} samples/s")
            self._begin()

    def validated(self, found: dict[str, Any], samples_per_second: float, waiting: float) -> None:
        """Measures of a validation, and the speed since the one before; ``waiting``: share of the time for data."""
        skills = ", ".join(f"{name} {entry['auc']:.3f}" for name, entry in found["skills"].items())
        self._progress.note(
            f"{self._what}: update {found['update']:,}, loss {found['training_loss']:.3f}, validation AUC {skills}, "
            f"balanced accuracy {found['balanced_accuracy']:.1%}, calibration error {found['calibration_error']:.3f}; "
            f"{samples_per_second:.0f} samples/s, {waiting:.1%} of the time for data"
        )
        self._begin()  # the validation's time is not the updates'
