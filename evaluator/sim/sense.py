"""Height maps as a depth camera with faults shows them.

The noise has two parts, as in the model of Dex-Net 2.0 (Mahler et al., 2017): every pixel's own, and one that
neighbours share. Pixels at edges are lost (they read as the ground) or fly between the two heights. All of it is drawn
from the seed of the scenario, with counters instead of a state, and rounded to 0.1 mm: the same map in any order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from rema_data.schema import HEIGHT_STEP_M, Observation
from rema_data.variation import Sense

__all__ = ["sensed"]

SHARED_PIXELS = 2.0
"""Width of the error that neighbours share, standard deviation in pixels."""
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
    seen = heights.astype(np.float64)
    if sense.block > 1:
        seen = _averaged(seen, sense.block)
    if sense.edges:
        seen = _edges(seen, sense.edges, rng)
    if sense.noise_m:
        sigma = sense.noise_m / HEIGHT_STEP_M
        own = rng.standard_normal(seen.shape)
        shared = gaussian_filter(rng.standard_normal(seen.shape), SHARED_PIXELS, mode="nearest")
        shared *= 2 * SHARED_PIXELS * np.sqrt(np.pi)  # a filtered map has this much less than unit variance
        seen = seen + sigma * (np.sqrt(1 - SHARED) * own + np.sqrt(SHARED) * shared)
    rounded: Array = np.clip(np.rint(seen), 0, _HIGHEST).astype(np.uint16)
    return rounded


def _averaged(heights: Array, block: int) -> Array:
    """Means of blocks of pixels, at the size of the map; the last blocks may be cut."""
    pixels = -(-heights.shape[0] // block) * block
    padded = np.pad(heights, (0, pixels - heights.shape[0]), mode="edge")
    means = padded.reshape(pixels // block, block, pixels // block, block).mean(axis=(1, 3))
    whole: Array = means.repeat(block, 0).repeat(block, 1)[: heights.shape[0], : heights.shape[1]]
    return whole


def _edges(heights: Array, share: float, rng: np.random.Generator) -> Array:
    """Of a share of the pixels at edges, half are lost and half fly somewhere between the heights around them."""
    high, low = maximum_filter(heights, 3, mode="nearest"), minimum_filter(heights, 3, mode="nearest")
    hit = (high - low > EDGE_M / HEIGHT_STEP_M) & (rng.random(heights.shape) < share)
    between = low + rng.random(heights.shape) * (high - low)
    lost = rng.random(heights.shape) < 0.5
    return np.where(hit, np.where(lost, 0.0, between), heights)
