"""Statistics of a LeRobot export: exact, over all frames, not estimated from a sample.

Maps have one number a plane, shape (C, 1, 1), which fits the planes of a frame; other features one number a component.
Quantiles are those of ``numpy.quantile``, with linear interpolation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.convert.base import Maps
from rema_data.heights import dequantise

__all__ = ["QUANTILES", "PlaneCounts", "episode_stats", "of_columns"]

Array = npt.NDArray[Any]
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_VALUES = 1 << 15
"""Stored heights are below this."""


class PlaneCounts:
    """How often each value occurs in each plane of the maps of a dataset."""

    def __init__(self, planes: int) -> None:
        self._counts = np.zeros((planes, _VALUES), np.int64)

    def add(self, plane: int, values: Array, times: int | Array = 1) -> None:
        """Count the stored values of maps (N, ...); ``times`` says how often each map occurs."""
        if np.isscalar(times):
            self._counts[plane] += np.bincount(values.reshape(-1), minlength=_VALUES)
            return
        for each, often in zip(values, np.broadcast_to(times, len(values)), strict=True):
            found = np.bincount(each.reshape(-1))
            self._counts[plane, : len(found)] += found * int(often)

    def stats(self, maps: Maps, masks: tuple[int, ...], frames: int) -> dict[str, Any]:
        """Statistics of a feature: values are heights as they are exported, those of the planes ``masks`` 0 and 1."""
        heights = np.arange(_VALUES, dtype=np.uint16)
        exported = dequantise(heights) if maps == "metres" else heights
        rows = []
        for plane, counts in enumerate(self._counts):
            known = np.flatnonzero(counts)
            rows.append(_of_counts((known if plane in masks else exported[known]).astype(np.float64), counts[known]))
        return {name: [[[row[name]]] for row in rows] for name in rows[0]} | {"count": [frames]}


def _of_counts(values: Array, counts: Array) -> dict[str, float]:
    """Statistics of values, ascending, that occur so often."""
    total = int(counts.sum())
    mean = math.fsum(values * counts) / total
    ends = np.cumsum(counts)
    return {
        "min": float(values[0]),
        "max": float(values[-1]),
        "mean": mean,
        "std": math.sqrt(math.fsum((values - mean) ** 2 * counts) / total),
        **{name: _quantile(values, ends, share * (total - 1)) for name, share in QUANTILES.items()},
    }


def _quantile(values: Array, ends: Array, place: float) -> float:
    """The value at a place between two of the values in order."""
    low, high = (float(values[np.searchsorted(ends, n, side="right")]) for n in (math.floor(place), math.ceil(place)))
    return low + (high - low) * (place - math.floor(place))


def of_columns(columns: Mapping[str, Array]) -> dict[str, Any]:
    """Statistics of features (N,) or (N, size) over all frames."""
    return {
        name: {key: value[0].tolist() for key, value in _of_groups(_grouped(array, len(array))).items()}
        | {"count": [len(array)]}
        for name, array in columns.items()
    }


def episode_stats(columns: Mapping[str, Array], lengths: Array) -> dict[str, Array]:
    """Statistics of every episode, (episodes, size), by their column name in ``meta/episodes``."""
    first = np.cumsum(lengths) - lengths
    found: dict[str, Array] = {}
    for length in np.unique(lengths):
        chosen = np.flatnonzero(lengths == length)
        rows = (first[chosen, None] + np.arange(length)).reshape(-1)
        for name, array in columns.items():
            stats = _of_groups(_grouped(array[rows], int(length)))
            stats["count"] = np.full((len(chosen), 1), length)
            for key, values in stats.items():
                column = found.setdefault(
                    f"stats/{name}/{key}", np.empty((len(lengths), values.shape[1]), values.dtype)
                )
                column[chosen] = values
    return found


def _grouped(array: Array, length: int) -> Array:
    return array.reshape(-1, length, array.shape[1] if array.ndim > 1 else 1).astype(np.float64)


def _of_groups(values: Array) -> dict[str, Array]:
    """Statistics over the middle axis."""
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=1)
    return {
        "min": values.min(1),
        "max": values.max(1),
        "mean": values.mean(1),
        "std": values.std(1),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }
