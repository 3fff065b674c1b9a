"""A chunk: some consecutive episodes of one block, the unit that is played, stored and committed."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from baselines.rounds.plan import BlockPlan
from rema_data.schema import Episode
from rema_data.store.block import BlockKey, EncodedMaps, encode_episodes
from rema_data.store.tables import to_parquet

__all__ = ["CHUNK_EPISODES", "Chunk", "EncodedChunk", "cut"]

CHUNK_EPISODES = 250
"""Some seconds of work: what is lost at most when a collection is killed, a few times over."""
_MAPS = ("scene", "ee_row", "ee_depth", "ee_mask")


class Chunk(NamedTuple):
    """Episodes ``start`` to ``stop`` of a block."""

    block: BlockKey
    start: int
    stop: int

    @property
    def name(self) -> str:
        """Name of its file, and of its line in the log."""
        return f"round-{self.block.round}-{self.block.task}-{self.block.split}-{self.start:07d}"


def cut(blocks: Sequence[BlockPlan], episodes: int = CHUNK_EPISODES) -> Iterator[Chunk]:
    """The chunks of some blocks, in order."""
    for block in blocks:
        for start in range(0, block.episodes, episodes):
            yield Chunk(block.key, start, min(start + episodes, block.episodes))


@dataclass(frozen=True, slots=True, eq=False)
class EncodedChunk:
    """Tables and maps of a chunk, as ``BlockWriter.append`` takes them.

    Attributes
    ----------
    episodes, steps : pyarrow.Table
    maps : EncodedMaps
    """

    episodes: pa.Table
    steps: pa.Table
    maps: EncodedMaps

    @classmethod
    def of(cls, episodes: Sequence[Episode]) -> EncodedChunk:
        """Encode episodes."""
        return cls(*encode_episodes(episodes))

    def to_bytes(self) -> bytes:
        """A compressed npz of the maps and of both tables as Parquet bytes."""
        tables = {"episodes": self.episodes, "steps": self.steps}
        arrays: dict[str, npt.NDArray[Any]] = {
            name: np.frombuffer(to_parquet(table), np.uint8) for name, table in tables.items()
        }
        arrays |= {name: getattr(self.maps, name) for name in _MAPS}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
        return buffer.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> EncodedChunk:
        """Inverse of ``to_bytes``, for bytes whose sha256 was checked."""
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            episodes, steps = (pq.read_table(pa.BufferReader(arrays[name].tobytes())) for name in ("episodes", "steps"))
            return cls(episodes, steps, EncodedMaps(**{name: arrays[name] for name in _MAPS}))
