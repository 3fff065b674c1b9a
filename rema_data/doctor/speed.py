"""How many training samples a second this machine reads from the decoded cache."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rema_data.loader.dataset import Delivery
    from rema_data.loader.release import Release

__all__ = ["BATCH_SIZES", "Speed", "measure"]

BATCH_SIZES = (8, 256)
"""The paper's batch, and a large one."""


@dataclass(frozen=True, slots=True)
class Speed:
    """Random reads by one process.

    Attributes
    ----------
    delivery : str
        ``quantised`` or ``float32``.
    batch_size : int
    samples_per_s : float
    """

    delivery: str
    batch_size: int
    samples_per_s: float


def measure(release: Release, seconds: float = 1.0) -> Iterator[Speed]:
    """Read random batches for about so long in each way of delivery and size of batch.

    Raises
    ------
    StorageError, IntegrityError, MissingFileError
        The decoded cache cannot be built.
    """
    deliveries: tuple[Delivery, ...] = ("quantised", "float32")
    rng = np.random.default_rng(0)
    for delivery in deliveries:
        dataset = release.steps(which="all", maps=delivery)
        for size in BATCH_SIZES:
            dataset[rng.integers(len(dataset), size=size)]  # opens the files
            read, began = 0, time.perf_counter()
            while (passed := time.perf_counter() - began) < seconds or not read:
                dataset[rng.integers(len(dataset), size=size)]
                read += size
            yield Speed(delivery, size, read / passed)
