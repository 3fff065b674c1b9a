"""Height maps as a depth camera with faults shows them.

The noise has two parts, as in the model of Dex-Net 2.0 (Mahler et al., 2017): every pixel's own, and one that
neighbours share. Pixels at edges are lost (they read as the ground) or fly between the two heights. All of it is drawn
from the seed of the scenario, with counters instead of a state, and rounded to 0.1 mm: the same map in any order.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.schema import HEIGHT_STEP_M, Observation
from rema_data.variation import Sense

__all__ = ["sensed"]

SHARED_PIXELS = 4
"""Distance of the points between which an error that neighbours share is interpolated."""
SHARED = 0.5
"""Part of the variance that neighbours share."""
EDGE_M = 0.005
"""Neighbours that differ by more than this make an edge."""
_HIGHEST = 5000
"""0.5 m in units of 0.1 mm: no map is higher."""

Array = npt.NDArray[Any]


def sensed(observation: Observation, sense: Sense) -> Observation:
    """An observation through a camera with faults; masks stay as they are, they are not measured."""
    scene = _seen(observation.scene, sense, 0)
    same = np.array_equal(observation.depth[0], observation.depth[1])
    first = _seen(observation.depth[0], sense, 1)
    second = first if same else _seen(observation.depth[1], sense, 2)
    return Observation(scene, np.stack([first, second]), observation.mask)


def _seen(heights: Array, sense: Sense, stream: int) -> Array:
    rng = np.random.Generator(np.random.Philox(key=[sense.seed, stream]))
    seen = heights.astype(np.float32)
    if sense.block > 1:
        seen = _averaged(seen, sense.block)
    if sense.edges:
        _damage_edges(seen[_around_things(heights, sense.block)], sense.edges, rng)
    if sense.noise_m:
        noise = _noise(len(seen), rng)
        noise *= np.float32(sense.noise_m / HEIGHT_STEP_M)
        seen += noise
    np.rint(seen, out=seen)
    return np.clip(seen, 0, _HIGHEST, out=seen).astype(np.uint16)


def _averaged(heights: Array, block: int) -> Array:
    """Means of blocks of pixels, at the size of the map; the last blocks may be cut."""
    pixels = -(-len(heights) // block)
    padded = np.pad(heights, (0, pixels * block - len(heights)), mode="edge")
    means = padded.reshape(pixels, block, pixels, block).mean(axis=(1, 3))
    whole: Array = means.repeat(block, 0).repeat(block, 1)[: len(heights), : len(heights)]
    return whole


def _around_things(heights: Array, margin: int) -> tuple[slice, ...]:
    """Where a map is not flat, with a margin in pixels: the rest, which is most of it, has no edges."""
    used = (np.flatnonzero(heights.max(axis=axis)) for axis in (1, 0))
    return tuple(slice(max(0, own[0] - margin), own[-1] + 1 + margin) if len(own) else slice(0) for own in used)


def _damage_edges(seen: Array, share: float, rng: np.random.Generator) -> None:
    """Of a share of the pixels at edges, half are lost and half fly somewhere between the heights around them."""
    low, high = _around(seen, np.minimum), _around(seen, np.maximum)
    edge = np.flatnonzero(high - low > EDGE_M / HEIGHT_STEP_M)
    hit = edge[rng.random(len(edge), np.float32) < share]
    lost, place = rng.random((2, len(hit)), np.float32)
    low, high = low.ravel()[hit], high.ravel()[hit]
    seen.flat[hit] = np.where(lost < 0.5, 0, low + place * (high - low))


def _around(heights: Array, extreme: np.ufunc) -> Array:
    """The lowest or highest of each pixel and its eight neighbours."""
    rows = heights.copy()
    extreme(rows[1:], heights[:-1], out=rows[1:])
    extreme(rows[:-1], heights[1:], out=rows[:-1])
    found = rows.copy()
    extreme(found[:, 1:], rows[:, :-1], out=found[:, 1:])
    extreme(found[:, :-1], rows[:, 1:], out=found[:, :-1])
    return found


def _noise(pixels: int, rng: np.random.Generator) -> Array:
    """Errors of unit variance, float32 (pixels, pixels): every pixel's own, and one that neighbours share."""
    between = _interpolation(pixels)
    points = between.shape[1]
    shared: Array = between @ rng.standard_normal((points, points), np.float32) @ between.T
    mixed: Array = rng.standard_normal((pixels, pixels), np.float32)
    mixed *= np.float32((1 - SHARED) ** 0.5)
    shared *= np.float32(SHARED**0.5)
    mixed += shared
    return mixed


@cache
def _interpolation(pixels: int) -> Array:
    """Weights of points ``SHARED_PIXELS`` apart, linear, float32 (pixels, points); each row has unit length."""
    at = np.arange(pixels) / SHARED_PIXELS
    points = np.arange(pixels // SHARED_PIXELS + 2)
    weights = np.clip(1 - np.abs(at[:, None] - points), 0, 1)
    unit: Array = (weights / np.linalg.norm(weights, axis=1, keepdims=True)).astype(np.float32)
    return unit
