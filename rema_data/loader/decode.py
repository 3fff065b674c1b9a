"""From the files of a release to plain arrays: every file checked against the manifest, every shard decoded once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data import interrupts
from rema_data.errors import IntegrityError, MissingFileError
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.heights import decode_heights
from rema_data.loader.index import Categories, Index, encode_steps
from rema_data.progress import Progress, Silent
from rema_data.storage import file_sha256

if TYPE_CHECKING:
    from rema_data.release.folder import ReleaseFolder
    from rema_data.release.manifest import BlockEntry, FileEntry

__all__ = ["MAP_ARRAYS", "Put", "decode_blocks", "map_rows", "row_bytes"]

Array = npt.NDArray[Any]

MAP_ARRAYS: dict[str, tuple[str, tuple[int, ...]]] = {
    "scene": ("<i2", (SCENE_PIXELS, SCENE_PIXELS)),
    "ee_depth": ("<i2", (2, EE_PIXELS, EE_PIXELS)),
    "ee_mask": ("|u1", (2, EE_PIXELS, EE_PIXELS // 8)),
}
"""Type and shape of one row of every decoded array: heights in 0.1 mm above the table, masks packed."""


Put = Callable[[str, int, Array], None]
"""Stores rows of an array from a row on. Called from several threads, for rows that do not overlap."""


@dataclass(frozen=True, slots=True)
class _Piece:
    """Rows of one array of one block, and the row where they begin among all blocks."""

    name: str
    start: int
    stop: int
    target: int
    read: Callable[[str, int, int], Array]

    @property
    def bytes(self) -> int:
        return row_bytes(self.name) * (self.stop - self.start)

    def decode(self, put: Put) -> int:
        rows = self.read(self.name, self.start, self.stop)
        put(self.name, self.target, decode_heights(rows) if rows.dtype == np.uint16 else rows)
        return self.bytes


def row_bytes(name: str) -> int:
    """Bytes of one decoded row."""
    dtype, shape = MAP_ARRAYS[name]
    return int(np.dtype(dtype).itemsize * np.prod(shape))


def map_rows(blocks: Sequence[BlockEntry]) -> dict[str, int]:
    """Rows of every decoded array."""
    steps = sum(block.steps for block in blocks)
    maps = sum(block.end_effectors for block in blocks)
    return {"scene": steps, "ee_depth": maps, "ee_mask": maps}


def decode_blocks(
    release: ReleaseFolder,
    blocks: Sequence[BlockEntry],
    put: Put,
    *,
    jobs: int,
    progress: Progress | None = None,
) -> tuple[Index, Categories]:
    """Decode blocks one after the other; returns the index of their steps, whose map rows count over all of them.

    Raises IntegrityError for a file that is not the manifest's or cannot be decoded, MissingFileError for a missing
    one.
    """
    wanted = {block.key.path for block in blocks}
    files = [file for file in release.manifest.files if file.block in wanted]
    pool = ThreadPoolExecutor(jobs, thread_name_prefix="rema-decode")
    try:
        for _ in pool.map(lambda file: _check(release, file), files):
            interrupts.check()
        index, categories = _read_index(release, blocks)
        pieces = list(_pieces(release, blocks))
        progress = progress or Silent()
        progress.phase(f"decode {release.manifest.name}", sum(piece.bytes for piece in pieces))
        for future in as_completed([pool.submit(piece.decode, put) for piece in pieces]):
            progress.advance(future.result())
            interrupts.check()
    finally:
        pool.shutdown(cancel_futures=True)
    return index, categories


def _check(release: ReleaseFolder, entry: FileEntry) -> None:
    path = release.file(entry)
    try:
        got = file_sha256(path)
    except FileNotFoundError:
        raise MissingFileError(f"file {path} does not exist", hint=release.repair.at(path), path=str(path)) from None
    if got != entry.sha256:
        raise IntegrityError(
            f"file {path} is not the one that was sealed: its sha256 is {got}, the manifest says {entry.sha256}",
            hint=release.repair.at(path),
            path=str(path),
            expected=entry.sha256,
            got=got,
        )


def _read_index(release: ReleaseFolder, blocks: Sequence[BlockEntry]) -> tuple[Index, Categories]:
    """Index of the blocks in a row, its map rows counted over all of them."""
    tables = [release.block(block).steps() for block in blocks]
    index, categories = encode_steps(tables)
    start = first_map = 0
    for block, table in zip(blocks, tables, strict=True):
        rows = index[start : start + len(table)]
        for name, count in (("scene_row", block.steps), ("ee_row", block.end_effectors)):
            if len(table) != block.steps or (len(rows) and not 0 <= rows[name].min() <= rows[name].max() < count):
                raise _contradiction(release, block, f"{name} of steps.parquet points outside of its {count} rows")
        rows["scene_row"] += start
        rows["ee_row"] += first_map
        start += block.steps
        first_map += block.end_effectors
    return index, categories


def _pieces(release: ReleaseFolder, blocks: Sequence[BlockEntry]) -> Iterator[_Piece]:
    offsets = dict.fromkeys(MAP_ARRAYS, 0)
    for block in blocks:
        maps = release.block(block).maps()
        for name, count in map_rows([block]).items():
            if maps.rows(name) != count:
                raise _contradiction(release, block, f"{name} has {maps.rows(name)} rows, the manifest says {count}")
            for start, stop in maps.pieces(name):
                yield _Piece(name, start, stop, offsets[name] + start, maps.read)
            offsets[name] += count


def _contradiction(release: ReleaseFolder, block: BlockEntry, what: str) -> IntegrityError:
    folder = release.block(block).folder
    return IntegrityError(
        f"block {folder} contradicts itself: {what}",
        hint=f"find all damage: {release.repair.verify}",
        path=str(folder),
    )
