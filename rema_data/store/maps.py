"""The maps of a block: one Zarr v3 group, ``maps.zarr``, with three sharded arrays.

========== ====== ================== ==========================================================
array      dtype  shape              content
========== ====== ================== ==========================================================
scene      uint16 (steps, 64, 64)    height above the table, fixed point (``rema_data.heights``)
ee_depth   uint16 (M, 2, 112, 112)   end-effector height of two states, fixed point
ee_mask    uint8  (M, 2, 112, 14)    may the topmost body touch the target: eight pixels a byte
========== ====== ================== ==========================================================

M counts end-effector maps that differ: ``ee_row`` of a step points at its own. Each inner chunk carries a CRC-32C, and
a chunk that is lost reads as values that cannot occur, so that a hole is an error and not a flat table.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import zarr
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec
from zarr.errors import BaseZarrError
from zarr.storage import LocalStore

from rema_data.errors import IntegrityError, MissingFileError
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.heights import HEIGHT_ERROR_M, HEIGHT_OFFSET_M, MISSING
from rema_data.interrupts import check
from rema_data.json_files import read_json
from rema_data.repair import RepairHint, ask_verify
from rema_data.schema import HEIGHT_STEP_M
from rema_data.storage import not_written, storage_errors

__all__ = ["ARRAYS", "MAPS", "ArrayFormat", "MapsReader", "MapsWriter"]

MAPS = "maps.zarr"
_LEVEL = 19
"""Of zstd. Shuffling makes these maps larger: they are long runs of equal 16-bit values (benchmarks/codecs.py)."""
_CODECS = ["sharding_indexed", "bytes", "zstd", "crc32c", "bytes", "crc32c"]
"""Of an array, of its inner chunks, and of the index of these."""
_MASK_HOLE = 255
"""Fill value of the masks: a map whose every pixel may touch cannot occur, since its border is always empty."""


@dataclass(frozen=True, slots=True)
class ArrayFormat:
    """How one array is stored."""

    dtype: str
    row: tuple[int, ...]  # shape of one row
    chunk_rows: int  # rows of an inner chunk: the unit of reading
    shard_rows: int  # rows of a shard: a file
    fill: int  # what a lost chunk reads as


ARRAYS: dict[str, ArrayFormat] = {
    "scene": ArrayFormat("uint16", (SCENE_PIXELS, SCENE_PIXELS), 256, 8192, MISSING),
    "ee_depth": ArrayFormat("uint16", (2, EE_PIXELS, EE_PIXELS), 64, 2048, MISSING),
    "ee_mask": ArrayFormat("uint8", (2, EE_PIXELS, EE_PIXELS // 8), 256, 8192, _MASK_HOLE),
}

_HEIGHTS = {
    "unit": "m",
    "height": "value * step_m + offset_m",
    "step_m": HEIGHT_STEP_M,
    "offset_m": HEIGHT_OFFSET_M,
    "max_error_m": HEIGHT_ERROR_M,
    "missing": MISSING,
}
_ATTRIBUTES: dict[str, dict[str, Any]] = {
    "scene": _HEIGHTS | {"meaning": "height above the table", "axes": "step, row (world y), column (world x)"},
    "ee_depth": _HEIGHTS
    | {"meaning": "height above the end effector's lowest allowed point", "axes": "map, state, row (y), column (x)"},
    "ee_mask": {
        "meaning": "1 where the topmost body may touch the target",
        "packing": "eight pixels of a row in one byte, the first in the highest bit",
        "axes": "map, state, row (y), column (x) / 8",
    },
}


class _Buffered:
    """One growing array that is written a whole shard at a time."""

    def __init__(self, group: zarr.Group, name: str) -> None:
        form = ARRAYS[name]
        self._form = form
        self._array = group.create_array(
            name,
            shape=(0, *form.row),
            dtype=form.dtype,
            chunks=(form.chunk_rows, *form.row),
            shards=(form.shard_rows, *form.row),
            serializer=BytesCodec(),
            compressors=[ZstdCodec(level=_LEVEL), Crc32cCodec()],
            fill_value=form.fill,
            config={"write_empty_chunks": True},
            attributes=_ATTRIBUTES[name],
        )
        self._digest = hashlib.sha256()
        self._rows: list[npt.NDArray[Any]] = []
        self._count = 0
        self.written = 0

    def append(self, rows: npt.NDArray[Any]) -> None:
        rows = np.ascontiguousarray(rows, self._form.dtype)
        while len(rows):
            room = self._form.shard_rows - self._count
            self._rows.append(rows[:room])
            self._count += len(rows[:room])
            rows = rows[room:]
            if self._count == self._form.shard_rows:
                self.flush()

    def flush(self) -> None:
        if self._count:
            rows = np.concatenate(self._rows)
            self._array.append(rows)
            self._digest.update(rows.data)
            self.written += self._count
            self._rows, self._count = [], 0

    def is_as_written(self) -> bool:
        """Whether what can be read is what was appended."""
        found = hashlib.sha256()
        for start in range(0, self.written, self._form.shard_rows):
            check()
            try:
                rows = np.asarray(self._array[start : start + self._form.shard_rows])
            except Exception:  # zarr and its codecs each raise their own kinds
                return False
            found.update(np.ascontiguousarray(rows).data)
        return found.digest() == self._digest.digest()


class MapsWriter:
    """Writes ``maps.zarr`` into a block that has none, in order. Every method raises StorageError on a full disk."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / MAPS
        with storage_errors(self._path):
            group = zarr.create_group(LocalStore(self._path), zarr_format=3, attributes={"rema": "maps"})
            self._arrays = {name: _Buffered(group, name) for name in ARRAYS}

    def append(self, name: str, rows: npt.NDArray[Any]) -> None:
        """Append stored rows (fixed point, packed) to one array."""
        with storage_errors(self._path):
            self._arrays[name].append(rows)

    def close(self) -> dict[str, int]:
        """Write what is left, and read all of it back; rows of every array."""
        with storage_errors(self._path):
            for name, array in self._arrays.items():
                array.flush()
                check()
                if not array.is_as_written():
                    raise not_written(self._path / name)
        return {name: array.written for name, array in self._arrays.items()}


class MapsReader:
    """Reads stored rows of a block's maps. For training use ``rema_data.load``: it decodes once.

    ``repair_hint`` gives the hint of an error about a path in the block. Raises MissingFileError or IntegrityError.
    """

    def __init__(self, folder: Path, repair_hint: RepairHint = ask_verify) -> None:
        self._path = folder / MAPS
        self._repair_hint = repair_hint
        if not (self._path / "zarr.json").is_file():
            raise MissingFileError(
                f"there are no maps at {self._path}", hint=repair_hint(self._path), path=str(self._path)
            )
        self._arrays: dict[str, zarr.Array[Any]] = {}
        for name, form in ARRAYS.items():
            try:
                _check_layout(self._path / name, form)
                array = zarr.open_array(LocalStore(self._path, read_only=True), path=name, mode="r")
            except (BaseZarrError, OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
                raise self._damage(name, str(error)) from error
            if array.shape[1:] != form.row or array.dtype != form.dtype:
                raise self._damage(name, f"it holds {array.dtype} {array.shape}")
            self._arrays[name] = array

    def _damage(self, name: str, why: str) -> IntegrityError:
        path = self._path / name
        return IntegrityError(f"array {path} is damaged: {why}", hint=self._repair_hint(path), path=str(path))

    def rows(self, name: str) -> int:
        """Number of rows of an array."""
        return int(self._arrays[name].shape[0])

    def read(self, name: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Stored rows ``start`` to ``stop`` of an array; raises IntegrityError where a chunk is lost or damaged."""
        array = self._arrays[name]
        try:
            rows: npt.NDArray[Any] = np.asarray(array[start:stop])
        except Exception as error:  # zarr, numcodecs and google_crc32c each raise their own kinds
            raise self._damage(name, f"rows {start} to {stop} cannot be decoded ({error})") from error
        hole = _hole(rows, ARRAYS[name].fill)
        if hole is not None:
            raise self._damage(name, f"row {start + hole} is missing")
        return rows

    def pieces(self, name: str) -> Sequence[tuple[int, int]]:
        """Row ranges of the array's shards: the pieces in which it is best read."""
        total, step = self.rows(name), ARRAYS[name].shard_rows
        return [(start, min(start + step, total)) for start in range(0, total, step)]


def _check_layout(folder: Path, form: ArrayFormat) -> None:
    """Raise ValueError, LookupError or TypeError where an array is not laid out as ``MapsWriter`` does it.

    Zarr can name any size of a chunk and any codec, and reads rows for which nothing is stored.
    """
    about = read_json(folder / "zarr.json")
    (sharding,) = about["codecs"]
    inner = sharding["configuration"]
    shard, chunk = about["chunk_grid"]["configuration"]["chunk_shape"], inner["chunk_shape"]
    codecs = [codec["name"] for codec in (sharding, *inner["codecs"], *inner["index_codecs"])]
    if shard != [form.shard_rows, *form.row] or chunk != [form.chunk_rows, *form.row] or codecs != _CODECS:
        raise ValueError("it is not stored in the chunks of a release")
    if about["fill_value"] != form.fill:  # by which a missing row is known
        raise ValueError(f"its fill value is {about['fill_value']!r:.40}, not {form.fill}")
    rows = about["shape"][0]
    stored = form.shard_rows * sum(1 for _ in (folder / "c").iterdir()) if (folder / "c").is_dir() else 0
    if type(rows) is not int or not 0 <= rows <= stored:
        raise ValueError(f"it names {rows!r:.40} rows, and {stored:,} are stored at most")


def _hole(rows: npt.NDArray[Any], fill: int) -> int | None:
    """First row that holds nothing but the fill value."""
    if not rows.size:
        return None
    suspects = np.flatnonzero(rows.reshape(len(rows), -1)[:, 0] == fill)
    for row in suspects:
        if (rows[row] == fill).all():
            return int(row)
    return None
