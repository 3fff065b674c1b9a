"""The variations of the episodes of one block: each can be read, is of its episode, and holds what a world can hold."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from rema_data.schema import to_dict
from rema_data.store.block import EPISODES
from rema_data.store.columns import VARIATION
from rema_data.variation import Variation, variation_from_text
from rema_data.verify.findings import Add, rows_of

__all__ = ["check_variations"]


def check_variations(episodes: pa.Table, report: Add) -> None:
    """Check the column ``variation`` of a table of episodes; each rule reports once, with the rows that break it."""
    broken: dict[str, list[int]] = {}
    numbers = episodes["episode"].to_pylist()
    for row, (number, text) in enumerate(zip(numbers, episodes[VARIATION].to_pylist(), strict=True)):
        for detail in () if text is None else _faults(text, number):
            broken.setdefault(detail, []).append(row)
    for detail, rows in broken.items():
        bad = np.zeros(len(episodes), bool)
        bad[rows] = True
        report("variations", EPISODES, rows_of(bad), detail)


def _faults(text: str, episode: int) -> Iterator[str]:
    """What is wrong with the variation of an episode."""
    try:
        variation = variation_from_text(text)
    except ValueError:
        yield "the variation cannot be read"
        return
    if not variation.axis or variation.level < 1:
        yield "the variation names no axis and level"
    if variation.base != episode:
        yield "the variation is that of another episode"
    if variation.seen:
        yield "the variation says what is seen, which the maps of the step say"
    if not all(map(math.isfinite, _numbers(to_dict(variation)))):
        yield "the variation holds a number that is not finite"
    if not _possible(variation):
        yield "the variation holds a size, a noise or a camera that cannot be"


def _possible(variation: Variation) -> bool:
    specs = [thing.spec for thing in (*variation.others, *variation.posts)]
    sizes = [size for spec in specs for size in (spec.length_m, spec.width_m, spec.height_m)]
    sense = variation.sense
    camera = sense is None or (
        0 <= sense.seed < 2**64 and sense.noise_m >= 0 and 0 <= sense.edges <= 1 and sense.block >= 1
    )
    return camera and all(size > 0 for size in sizes)


def _numbers(value: Any) -> Iterator[float]:
    """Every floating-point number inside plain values."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from _numbers(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
