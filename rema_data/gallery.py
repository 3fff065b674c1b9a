"""Steps of a release to look at: chosen by place or by outcome, with what was observed.

Only the chosen rows are decoded: looking at a dozen steps needs no decoded cache.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rema_data.errors import InputError
from rema_data.heights import decode_heights, unpack_mask
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import Observation
from rema_data.store.block import BlockReader
from rema_data.store.columns import VARIATION

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["GalleryStep", "find_steps", "steps_with_maps"]

_MOST = np.iinfo(np.int32).max
"""An episode's number is an int32."""


@dataclass(frozen=True, slots=True)
class GalleryStep:
    """A step to look at."""

    row: Mapping[str, Any]  # of ``steps.parquet``, with its episode's ``variation``: see ``rema_data.store.columns``
    observation: Observation


def find_steps(
    release: ReleaseFolder,
    tasks: Iterable[str] | None = None,
    rounds: Iterable[int] | None = None,
    split: str | None = None,
    *,
    episodes: Collection[int] = (),
    which: Literal["last", "picks", "all"] = "last",
    success: bool | None = None,
    failure: str | None = None,
    count: int = 12,
) -> list[GalleryStep]:
    """Steps of the local blocks of a release, in its order.

    With ``episodes``: all steps of these. Without: ``count`` steps that look drawn at random, always the same ones, of
    the last steps of their task, the steps before them (picks), or all. ``success`` and ``failure`` select by outcome.

    Raises
    ------
    InputError
        The release has no such block, episode or step.
    MissingFileError
        None of the blocks is on this machine.
    IntegrityError
        A file of the release is damaged.
    """
    wanted = release.manifest.select(tasks, rounds, split)
    local = {block.key for block in release.blocks()}
    blocks = [block for block in wanted if block.key in local]
    if not blocks:
        release.require(wanted)
    tables = [_kept(_steps(release.block(block)), episodes, which, success, failure) for block in blocks]
    ends = np.cumsum([table.num_rows for table in tables])
    chosen = np.arange(ends[-1])
    if not len(chosen):
        raise InputError(
            f"{release.manifest.name} has no such step", hint="ask for other episodes or outcomes: see `rema stats`"
        )
    if not episodes:
        rng = np.random.default_rng(int(release.manifest.sha256[:16], 16))
        chosen = np.sort(rng.permutation(chosen)[:count])
    found: list[GalleryStep] = []
    for block, table, end in zip(blocks, tables, ends, strict=True):
        here = chosen[(chosen >= end - table.num_rows) & (chosen < end)] - (end - table.num_rows)
        found += steps_with_maps(release.block(block), table.take(here).to_pylist())
    return found


def _steps(reader: BlockReader) -> pa.Table:
    """The steps of a block, with the variation of their episodes."""
    episodes = reader.episodes()
    rows = np.repeat(np.arange(len(episodes)), episodes["steps"].to_numpy())
    return reader.steps().append_column(VARIATION, episodes[VARIATION].take(rows))


def _kept(
    steps: pa.Table, episodes: Collection[int], which: str, success: bool | None, failure: str | None
) -> pa.Table:
    """The rows of a table that are asked for."""
    import pyarrow as pa
    import pyarrow.compute as pc

    keep = pa.array(np.ones(steps.num_rows, bool))
    if episodes:
        possible = sorted(number for number in episodes if number <= _MOST)
        keep = pc.is_in(steps["episode"], value_set=pa.array(possible, steps["episode"].type))
    elif which != "all":
        keep = pc.equal(steps["last"], which == "last")
    if success is not None:
        keep = pc.and_(keep, pc.equal(steps["success"], success))
    if failure is not None:
        keep = pc.and_(keep, pc.fill_null(pc.equal(steps["failure"], failure), False))
    return steps.filter(keep)


def steps_with_maps(reader: BlockReader, rows: Sequence[Mapping[str, Any]]) -> Iterator[GalleryStep]:
    """Rows of a block's steps, each with what was observed; raises as ``find_steps`` about damage."""
    maps = reader.maps()
    for row in rows:
        scene, depth = (
            decode_heights(maps.read(name, row[place], row[place] + 1)[0]).clip(0).astype(np.uint16)
            for name, place in (("scene", "scene_row"), ("ee_depth", "ee_row"))
        )
        mask = unpack_mask(maps.read("ee_mask", row["ee_row"], row["ee_row"] + 1)[0])
        yield GalleryStep(row, Observation(scene, depth, mask))
