"""A block: all episodes of one (round, task, split), as a folder of whole files.

::

    round-1/grasp/train/
        episodes.parquet    one row an episode
        steps.parquet       one row an executed step, with the rows of its maps
        maps.zarr/          scene, ee_depth, ee_mask

A subset of a release is a set of blocks. A block is written once and never changed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rema_data.bounded import MOST_ROWS
from rema_data.heights import encode_heights, pack_mask
from rema_data.repair import RepairHint, ask_verify
from rema_data.schema import Episode, Observation
from rema_data.storage import write_atomic
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS, VARIATION, version_with
from rema_data.store.keys import SPLITS, BlockKey
from rema_data.store.tables import (
    as_stored,
    episode_row,
    episodes_table,
    read_table,
    step_row,
    steps_table,
    table_version,
    to_parquet,
    with_column,
    with_version,
)

if TYPE_CHECKING:
    # Zarr is imported where maps are read or written: looking at tables does without it.
    from rema_data.store.maps import MapsReader

__all__ = ["EPISODES", "SPLITS", "STEPS", "BlockKey", "BlockReader", "BlockWriter", "EncodedMaps", "encode_episodes"]

EPISODES, STEPS = "episodes.parquet", "steps.parquet"
Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class EncodedMaps:
    """Maps of some steps as they are stored."""

    scene: Array  # uint16 (N, 64, 64)
    ee_row: Array  # int32 (N,): row of every step's end-effector map in the two arrays below
    ee_depth: Array  # uint16 (M, 2, 112, 112)
    ee_mask: Array  # uint8 (M, 2, 112, 14)


def encode_maps(observations: Sequence[Observation]) -> EncodedMaps:
    """Observations as stored maps, equal end-effector maps once."""
    from rema_data.store.maps import ARRAYS

    known: dict[bytes, int] = {}
    rows: list[int] = []
    kept: list[Observation] = []
    for seen in observations:
        digest = hashlib.sha256(seen.depth.tobytes() + np.packbits(seen.mask).tobytes()).digest()
        rows.append(known.setdefault(digest, len(kept)))
        if rows[-1] == len(kept):
            kept.append(seen)

    def stacked(maps: list[Array], name: str) -> Array:
        form = ARRAYS[name]
        return np.stack(maps) if maps else np.empty((0, *form.row), form.dtype)

    return EncodedMaps(
        stacked([encode_heights(seen.scene) for seen in observations], "scene"),
        np.array(rows, np.int32),
        stacked([encode_heights(seen.depth) for seen in kept], "ee_depth"),
        stacked([pack_mask(seen.mask) for seen in kept], "ee_mask"),
    )


def encode_episodes(episodes: Sequence[Episode], version: int = 1) -> tuple[pa.Table, pa.Table, EncodedMaps]:
    """Episodes as the tables and maps of a block of their own: rows count from 0.

    They are to be stored in the schema version ``version``, or in the earliest later one that has all of theirs.
    """
    varied = any(episode.variation is not None for episode in episodes)
    version = max(version, version_with(*([VARIATION] if varied else [])))
    maps = encode_maps([step.observation for episode in episodes for step in episode.steps])
    episode_rows: list[dict[str, Any]] = []
    step_rows: list[dict[str, Any]] = []
    for episode in episodes:
        episode_rows.append(episode_row(episode, len(step_rows)))
        for step in episode.steps:
            row = len(step_rows)
            step_rows.append(step_row(episode, step, row, int(maps.ee_row[row])))
    return episodes_table(episode_rows, version), steps_table(step_rows, version), maps


class BlockWriter:
    """Writes a block into an empty or new folder, in order; its bytes do not depend on how the calls divide it."""

    def __init__(self, folder: Path) -> None:
        from rema_data.store.maps import MapsWriter

        self._folder = folder
        self._maps = MapsWriter(folder)
        self._episodes: list[pa.Table] = []
        self._steps: list[pa.Table] = []
        self._step_count = 0
        self._known: dict[bytes, int] = {}

    def append(self, episodes: pa.Table, steps: pa.Table, maps: EncodedMaps) -> None:
        """Append episodes as ``encode_episodes`` gives them: rows counted from 0 are moved to their place."""
        target = np.empty(len(maps.ee_depth), np.int32)
        new = []
        for row, (depth, mask) in enumerate(zip(maps.ee_depth, maps.ee_mask, strict=True)):
            digest = hashlib.sha256(depth.tobytes() + mask.tobytes()).digest()
            if digest not in self._known:
                self._known[digest] = len(self._known)
                new.append(row)
            target[row] = self._known[digest]
        self._maps.append("scene", maps.scene)
        self._maps.append("ee_depth", maps.ee_depth[new])
        self._maps.append("ee_mask", maps.ee_mask[new])
        scene_row = np.arange(self._step_count, self._step_count + len(maps.scene), dtype=np.int32)
        first = episodes.column("first_step").to_numpy() + np.int32(self._step_count)
        self._episodes.append(with_column(episodes, "first_step", first))
        self._steps.append(with_column(with_column(steps, "scene_row", scene_row), "ee_row", target[maps.ee_row]))
        self._step_count += len(maps.scene)

    def close(self) -> None:
        """Write the tables and what is left of the maps."""
        self._maps.close()
        for name, tables, columns in (
            (EPISODES, self._episodes, EPISODE_COLUMNS),
            (STEPS, self._steps, STEP_COLUMNS),
        ):
            version = max(map(table_version, tables))
            whole = with_version(pa.concat_tables(tables).combine_chunks(), version)
            write_atomic(self._folder / name, to_parquet(as_stored(whole, columns)))


class BlockReader:
    """Reads a block; ``repair_hint`` gives the hint of an error about a path in it.

    A table that announces more rows than ``most_episodes`` or ``most_steps`` is refused before it is read.
    """

    def __init__(
        self,
        folder: Path,
        repair_hint: RepairHint = ask_verify,
        most_episodes: int = MOST_ROWS,
        most_steps: int = MOST_ROWS,
    ) -> None:
        self.folder = folder
        self.repair_hint = repair_hint
        self._most_episodes, self._most_steps = most_episodes, most_steps

    def episodes(self) -> pa.Table:
        """Table of the episodes; see ``read_table`` for what it raises."""
        return read_table(self.folder / EPISODES, EPISODE_COLUMNS, self.repair_hint, self._most_episodes)

    def steps(self) -> pa.Table:
        """Table of the steps; see ``read_table`` for what it raises."""
        return read_table(self.folder / STEPS, STEP_COLUMNS, self.repair_hint, self._most_steps)

    def version(self) -> int:
        """The schema version of its tables: the newest one that has the columns of both."""
        return min(table_version(self.episodes()), table_version(self.steps()))

    def maps(self) -> MapsReader:
        """Reader of the maps."""
        from rema_data.store.maps import MapsReader

        return MapsReader(self.folder, self.repair_hint)
