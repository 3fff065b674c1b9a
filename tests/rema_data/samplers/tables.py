"""Tables for tests of the samplers."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.samplers import BalancedSampler

TASKS = ("grasp", "push", "grasp_grasp", "grasp_push")

Table = dict[str, npt.NDArray[Any]]


def table(sizes: dict[tuple[str, bool], int], seed: int = 0) -> Table:
    """A table with so many rows of each (task, success), in random order."""
    labels = [label for label, count in sizes.items() for _ in range(count)]
    order = np.random.default_rng(seed).permutation(len(labels))
    return {
        "task": np.array([label[0] for label in labels])[order],
        "success": np.array([label[1] for label in labels])[order],
    }


def uneven(rare: int = 7, common: int = 60) -> Table:
    """Four tasks with few successes; no two strata have the same size."""
    sizes = {(task, won): (rare if won else common) + 3 * n for n, task in enumerate(TASKS) for won in (True, False)}
    return table(sizes)


def labels_of(columns: Table, rows: npt.NDArray[Any]) -> list[tuple[str, bool]]:
    return [(str(columns["task"][row]), bool(columns["success"][row])) for row in rows]


def golden_digest(mode: str) -> str:
    """Hash of the first 1000 rows, which cross into a second epoch."""
    options: dict[str, Any] = {"cycle": {}, "average": {"mode": "average"}}
    sampler = BalancedSampler(uneven(), 8, seed=11, num_samples=504, **options[mode])
    rows = np.concatenate([batch for _ in range(2) for batch in sampler])[:1000]
    return hashlib.sha256(rows.astype("<i8").tobytes()).hexdigest()[:16]
