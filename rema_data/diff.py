"""What differs between two releases: which blocks, which rows of their tables, which columns, which maps.

A block whose files have the same sha256 in both is equal, and is not read. Of other blocks, episodes are compared by
their number and steps by episode and position; maps by their content, whatever row they lie in.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from rema_data import interrupts
from rema_data.errors import IntegrityError
from rema_data.progress import Progress, Silent
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import Manifest
from rema_data.store.block import BlockReader
from rema_data.store.keys import BlockKey
from rema_data.store.maps import MapsReader

__all__ = ["BlockDiff", "ReleaseDiff", "TableDiff", "diff_releases"]

_PLACES = frozenset({"first_step", "scene_row", "ee_row"})
"""Columns that say where something is stored, which is compared itself."""
_MAPS = {"scene": "scene_row", "ee_depth": "ee_row", "ee_mask": "ee_row"}
"""The column of steps that points into each array."""
_LISTED = frozenset({"blocks", "files"})
"""Fields of a manifest that list what is compared here."""
Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class TableDiff:
    """How a table of a block differs; the maps count as columns of the steps."""

    table: str  # ``episodes`` or ``steps``
    only_a: int  # rows without a row of the same episode (and step) in the other release
    only_b: int
    changed: int  # rows of both that differ in at least one column
    columns: Mapping[str, int]  # rows of both that differ, by column; columns without one are left out


@dataclass(frozen=True, slots=True)
class BlockDiff:
    """A block that is not the same in both releases.

    Its state is ``only in A``, ``only in B``, ``changed``, ``stored differently`` (other bytes, of the same rows and
    maps), or ``not compared`` (other bytes, and one of them is not on this machine).
    """

    block: str  # path
    state: str
    episodes: tuple[int, int]  # in A and in B
    steps: tuple[int, int]
    tables: tuple[TableDiff, ...] = ()  # those that differ
    fix: str = ""  # the command that brings a block that is not here


@dataclass(frozen=True, slots=True)
class ReleaseDiff:
    """The result of a comparison of release A with release B."""

    a: str
    b: str
    sha256: tuple[str, str]  # of the manifests: equal for equal releases
    equal_blocks: int  # with the same bytes
    blocks: tuple[BlockDiff, ...]  # the others
    fields: tuple[str, ...]  # of the manifest that differ, but for those that list blocks and files

    @property
    def equal(self) -> bool:
        """Whether both have the same blocks with the same bytes. They may be described differently."""
        return not self.blocks

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain dictionaries, lists and numbers, ready for JSON."""
        return {"equal": self.equal, **asdict(self)}


def diff_releases(a: ReleaseFolder, b: ReleaseFolder, progress: Progress | None = None) -> ReleaseDiff:
    """Compare two releases block by block.

    Raises
    ------
    IntegrityError, MissingFileError
        A file of a block that differs is damaged or missing.
    """
    sides = (a, b)
    keys = dict.fromkeys(block.key for side in sides for block in side.manifest.blocks)
    files = [_files(side.manifest) for side in sides]
    differing = [key for key in keys if files[0].get(key.path) != files[1].get(key.path)]
    progress = progress or Silent()
    progress.phase("compare blocks", len(differing))
    found = []
    for key in differing:
        interrupts.check()
        found.append(_block(key, a, b))
        progress.advance(1)
    return ReleaseDiff(
        a.manifest.name,
        b.manifest.name,
        (a.manifest.sha256, b.manifest.sha256),
        len(keys) - len(found),
        tuple(found),
        tuple(
            item.name
            for item in fields(Manifest)
            if item.name not in _LISTED and getattr(a.manifest, item.name) != getattr(b.manifest, item.name)
        ),
    )


def _block(key: BlockKey, a: ReleaseFolder, b: ReleaseFolder) -> BlockDiff:
    """A block whose files are not the same in both."""
    of_a, of_b = (next((block for block in side.manifest.blocks if block.key == key), None) for side in (a, b))
    if of_a is None or of_b is None:
        (a_episodes, a_steps), (b_episodes, b_steps) = (
            (0, 0) if block is None else (block.episodes, block.steps) for block in (of_a, of_b)
        )
        state = "only in B" if of_a is None else "only in A"
        return BlockDiff(key.path, state, (a_episodes, b_episodes), (a_steps, b_steps))
    episodes, steps = (of_a.episodes, of_b.episodes), (of_a.steps, of_b.steps)
    for side, block in ((a, of_a), (b, of_b)):
        if block not in side.blocks():
            return BlockDiff(key.path, "not compared", episodes, steps, fix=side.missing_hint([block]))
    tables = tuple(_tables(key, a.block(of_a), b.block(of_b)))
    return BlockDiff(key.path, "changed" if tables else "stored differently", episodes, steps, tables)


def _files(manifest: Manifest) -> dict[str, dict[str, str]]:
    """The sha256 of every file of every block, by path."""
    found: dict[str, dict[str, str]] = {}
    for file in manifest.files:
        if file.block is not None:
            found.setdefault(file.block, {})[file.path] = file.sha256
    return found


def _tables(key: BlockKey, a: BlockReader, b: BlockReader) -> Iterator[TableDiff]:
    """Tables of a block that differ."""
    for name, of_a, of_b in (("episodes", a.episodes(), b.episodes()), ("steps", a.steps(), b.steps())):
        _, in_a, in_b = np.intersect1d(
            _row_names(key, of_a), _row_names(key, of_b), assume_unique=True, return_indices=True
        )
        both = of_a.take(in_a), of_b.take(in_b)
        differ = {
            column: _differ(both[0][column], both[1][column]) for column in of_a.column_names if column not in _PLACES
        }
        if name == "steps":
            differ |= _maps_differ(a.maps(), b.maps(), *both)
        changed = np.logical_or.reduce([np.zeros(len(in_a), bool), *differ.values()])
        columns = {column: int(rows.sum()) for column, rows in differ.items() if rows.any()}
        only_a, only_b = len(of_a) - len(in_a), len(of_b) - len(in_b)
        if only_a or only_b or columns:
            yield TableDiff(name, only_a, only_b, int(changed.sum()), columns)


def _row_names(key: BlockKey, table: pa.Table) -> Array:
    """A number that names each row of a block's table: its episode, or its episode and step."""
    names: Array = table["episode"].to_numpy().astype(np.int64) << 8
    if "step" in table.column_names:
        names |= table["step"].to_numpy()
    if len(np.unique(names)) != len(names):
        raise IntegrityError(
            f"a table of {key.path} has two rows of one episode or step", hint="find all damage: rema verify"
        )
    return names


def _differ(a: pa.ChunkedArray, b: pa.ChunkedArray) -> Array:
    """Whether values differ, null from any value and floats by their bits; bool (rows,)."""
    left, right = a.combine_chunks(), b.combine_chunks()
    if pa.types.is_floating(left.type):
        left, right = left.view(pa.int64()), right.view(pa.int64())
    unequal = pc.fill_null(pc.not_equal(left, right), False)
    differ: Array = pc.or_(unequal, pc.xor(pc.is_null(left), pc.is_null(right))).to_numpy(zero_copy_only=False)
    return differ


def _maps_differ(a: MapsReader, b: MapsReader, of_a: pa.Table, of_b: pa.Table) -> dict[str, Array]:
    """Whether the maps of steps that both have differ, by array."""
    return {
        name: np.asarray(_digests(a, name)[of_a[pointer].to_numpy()] != _digests(b, name)[of_b[pointer].to_numpy()])
        for name, pointer in _MAPS.items()
    }


def _digests(reader: MapsReader, name: str) -> Array:
    """A hash of every row of an array."""
    found = np.empty(reader.rows(name), "S32")
    for start, stop in reader.pieces(name):
        interrupts.check()
        for row, content in enumerate(reader.read(name, start, stop), start):
            found[row] = hashlib.blake2b(content.tobytes(), digest_size=16).hexdigest()
    return found
