"""A block as a stream of pieces: whole episodes, a few hundred steps at a time, so that memory stays small."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data.errors import IntegrityError
from rema_data.store.block import BlockReader, EncodedMaps
from rema_data.store.maps import MapsReader
from rema_data.store.tables import with_column

__all__ = ["PIECE_STEPS", "Piece", "piece_bounds", "read_pieces"]

PIECE_STEPS = 256
"""Steps of a piece, at least one episode: some 50 MB of float32 maps."""

Array = npt.NDArray[Any]


class Piece(NamedTuple):
    """Some episodes of a block, as ``BlockWriter.append`` takes them: rows count from 0."""

    episodes: pa.Table
    steps: pa.Table
    maps: EncodedMaps


def read_pieces(reader: BlockReader, piece_steps: int = PIECE_STEPS) -> Iterator[Piece]:
    """Pieces of a block in order; MissingFileError or IntegrityError for a file of it."""
    episodes, steps, maps = reader.episodes(), reader.steps(), reader.maps()
    counts = episodes["steps"].to_numpy().astype(np.int64)
    ends = np.cumsum(counts)
    first = ends - counts
    total = int(ends[-1]) if len(ends) else 0
    scene_row, ee_row = steps["scene_row"].to_numpy(), steps["ee_row"].to_numpy()
    if (
        (counts < 1).any()
        or not np.array_equal(episodes["first_step"].to_numpy(), first)
        or not np.array_equal(scene_row, np.arange(total))
        or maps.rows("scene") != total
        or (total and not 0 <= ee_row.min() <= ee_row.max() < maps.rows("ee_depth"))
    ):
        raise IntegrityError(
            f"the tables and maps of {reader.folder} contradict each other",
            hint=reader.repair_hint(reader.folder),
            path=str(reader.folder),
        )
    for start, stop, begin, end in piece_bounds(counts, piece_steps):
        rows, local = np.unique(ee_row[begin:end], return_inverse=True)
        yield Piece(
            with_column(episodes.slice(start, stop - start), "first_step", first[start:stop] - begin),
            steps.slice(begin, end - begin),
            EncodedMaps(
                maps.read("scene", begin, end),
                local.astype(np.int32),
                _read_rows(maps, "ee_depth", rows),
                _read_rows(maps, "ee_mask", rows),
            ),
        )


def piece_bounds(counts: Array, piece_steps: int = PIECE_STEPS) -> Iterator[tuple[int, int, int, int]]:
    """First and last episode, first and last step of every piece, the last ones excluded; from steps of episodes."""
    ends = np.cumsum(counts, dtype=np.int64)
    start = begin = 0
    while start < len(ends):
        stop = max(start + 1, int(np.searchsorted(ends, begin + piece_steps, side="right")))
        yield start, stop, begin, int(ends[stop - 1])
        start, begin = stop, int(ends[stop - 1])


def _read_rows(maps: MapsReader, name: str, rows: Array) -> Array:
    """Some rows of an array, ascending, read in runs of neighbours."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    return np.concatenate([maps.read(name, int(run[0]), int(run[-1]) + 1) for run in runs])
