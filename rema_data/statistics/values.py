"""Count, mean, deviation, range and quantiles of the maps and actions of some steps: exact, from histograms.

A stored height is a whole number of 0.1 mm, a mask has two values, and an action is one of 65,536: how often each value
occurs says everything. Sums are whole numbers of any length, and only results are rounded, to float64.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data import grid, interrupts
from rema_data.errors import StorageError
from rema_data.json_files import checked_digest, read_json, with_digest
from rema_data.progress import Progress, Silent
from rema_data.schema import HEIGHT_STEP_M
from rema_data.storage import write_atomic

__all__ = ["ChannelValues", "Maps", "ValueStatistics", "read_values", "value_statistics", "write_values"]

_VERSION = 1
_PIECE = 256
"""Maps that are counted at a time."""
_HEIGHTS = np.arange(2**16, dtype=np.uint16).view(np.int16).tolist()
"""The height that every pair of bytes stands for, 0.1 mm."""
_BITS = np.unpackbits(np.arange(2**8, dtype=np.uint8)[:, None], axis=1).sum(1, dtype=np.int64)
"""Pixels of the mask in every byte."""
Array = npt.NDArray[Any]
Counts = npt.NDArray[np.int64]
Maps = tuple[Array, Array]
"""A decoded array, and the row of it that each step has, int64 (steps,)."""


@dataclass(frozen=True, slots=True)
class ChannelValues:
    """The values of one channel of a map, or of one component of the actions."""

    name: str  # ``scene``, ``depth_1`` and ``mask_1`` of state 1, ``depth_2``, ``mask_2``; an action's column
    unit: str  # m, rad, or empty
    count: int  # pixels of all steps, or steps
    mean: float
    std: float  # of this population: the squares are divided by ``count``
    min: float
    max: float
    q01: float  # quantiles, interpolated linearly between neighbours as ``numpy.quantile`` does
    q99: float


@dataclass(frozen=True, slots=True)
class ValueStatistics:
    """The values of a selection of steps: what they are normalised with."""

    fingerprint: str  # of the dataset
    steps: int
    channels: tuple[ChannelValues, ...]  # of the maps, then of the actions

    def __getitem__(self, name: str) -> ChannelValues:
        """The channel or component of a name; KeyError where there is none."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        raise KeyError(f"{name!r} is none of {', '.join(channel.name for channel in self.channels)}")

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain dictionaries and numbers, ready for JSON."""
        return {**asdict(self), "channels": [asdict(channel) for channel in self.channels]}


def value_statistics(
    fingerprint: str, scene: Maps, depth: Maps, mask: Maps, action: Array, progress: Progress | None = None
) -> ValueStatistics:
    """Statistics of steps from their decoded maps (see ``rema_data.loader.decode``) and their grid indices."""
    progress = progress or Silent()
    pixels = sum(len(np.unique(rows)) * array[0].size for array, rows in (scene, depth, mask))
    progress.phase("count values", pixels)
    (heights,) = _counted(scene, 1, np.uint16, progress)
    channels = [_heights("scene", heights)]
    depths, masks = _counted(depth, 2, np.uint16, progress), _counted(mask, 2, np.uint8, progress)
    for number, (of_depth, of_mask) in enumerate(zip(depths, masks, strict=True), 1):
        channels += [_heights(f"depth_{number}", of_depth), _mask(f"mask_{number}", of_mask)]
    return ValueStatistics(fingerprint, len(action), (*channels, *_actions(action)))


def _counted(maps: Maps, channels: int, kind: type[np.unsignedinteger[Any]], progress: Progress) -> list[Counts]:
    """How often the maps of all steps hold each value of their bytes, by channel; a map counts once for every step."""
    array, rows = maps
    levels = np.iinfo(kind).max + 1
    found = [np.zeros(levels, np.int64) for _ in range(channels)]
    unique, times = np.unique(rows, return_counts=True)
    for time in np.unique(times):
        of_time = unique[times == time]
        for start in range(0, len(of_time), _PIECE):
            interrupts.check()
            piece = (
                array.take(of_time[start : start + _PIECE], 0)
                .view(kind)
                .reshape(-1, channels, array[0].size // channels)
            )
            for number in range(channels):
                found[number] += time * np.bincount(piece[:, number].ravel(), minlength=levels)
            progress.advance(piece.size)
    return found


def _heights(name: str, counts: Counts) -> ChannelValues:
    return _summary(name, "m", zip(_HEIGHTS, counts.tolist(), strict=True), Fraction(str(HEIGHT_STEP_M)))


def _mask(name: str, counts: Counts) -> ChannelValues:
    ones = int(counts @ _BITS)
    return _summary(name, "", ((0, 8 * int(counts.sum()) - ones), (1, ones)))


def _actions(action: Array) -> Iterator[ChannelValues]:
    i, j, k = (np.bincount(part).tolist() for part in grid.decode(action))
    yield from (_summary(name, "", enumerate(counts)) for name, counts in (("i", i), ("j", j), ("k", k)))
    pixel = Fraction(str(grid.PIXEL_M))
    for name, counts in (("x_m", j), ("y_m", i)):
        yield _summary(name, "m", enumerate(counts), pixel, pixel * Fraction(1 - grid.SCENE_PIXELS, 2))
    yield _summary("theta_rad", "rad", enumerate(k), Fraction(2 * math.pi / grid.ANGLES))


def _summary(
    name: str, unit: str, counts: Iterable[tuple[int, int]], step: Fraction = Fraction(1), zero: Fraction = Fraction(0)
) -> ChannelValues:
    """Statistics of values ``zero + step * level`` from how often each level occurs."""
    occurring = sorted((level, times) for level, times in counts if times)
    n = sum(times for _, times in occurring)
    total = sum(level * times for level, times in occurring)
    squares = sum(level * level * times for level, times in occurring)

    def value(level: Fraction | int) -> float:
        return float(zero + step * level)

    return ChannelValues(
        name,
        unit,
        n,
        mean=value(Fraction(total, n)),
        std=float(step) * math.sqrt(Fraction(n * squares - total * total, n * n)),
        min=value(occurring[0][0]),
        max=value(occurring[-1][0]),
        q01=value(_quantile(occurring, n, Fraction(1, 100))),
        q99=value(_quantile(occurring, n, Fraction(99, 100))),
    )


def _quantile(occurring: Sequence[tuple[int, int]], n: int, share: Fraction) -> Fraction:
    """The level at a share of the way from the first to the last of ``n`` sorted values."""
    place = share * (n - 1)
    below, above = (_level(occurring, rank) for rank in (math.floor(place), math.ceil(place)))
    return below + (above - below) * (place % 1)


def _level(occurring: Sequence[tuple[int, int]], rank: int) -> int:
    for level, times in occurring:
        rank -= times
        if rank < 0:
            return level
    raise IndexError(rank)


def _path(folder: Path, fingerprint: str) -> Path:
    return folder / f"values-{fingerprint}.json"


def read_values(folder: Path, fingerprint: str) -> ValueStatistics | None:
    """Statistics that were written before; None where there are none, or none that can be used."""
    try:
        content = checked_digest(read_json(_path(folder, fingerprint)))
        if (content["version"], content["fingerprint"]) != (_VERSION, fingerprint):
            return None
        channels = tuple(ChannelValues(**channel) for channel in content["channels"])
        return ValueStatistics(fingerprint, content["steps"], channels)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_values(folder: Path, found: ValueStatistics) -> None:
    """Keep statistics in a folder; without effect where it cannot be written, as in a cache that others share."""
    content = with_digest({"version": _VERSION, **found.to_dict()})
    try:
        write_atomic(_path(folder, found.fingerprint), json.dumps(content, indent=1) + "\n")
    except StorageError:
        return
