"""The maps of one block: every chunk decoded, every height in range, every end-effector map different."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from rema_data.errors import IntegrityError
from rema_data.heights import MISSING
from rema_data.json_files import read_json
from rema_data.store.maps import ARRAYS, MAPS, MapsReader
from rema_data.verify.findings import Add, rows_of

__all__ = ["check_group", "check_maps"]

_HIGHEST = np.iinfo(np.int16).max
"""Highest stored height that the decoded form can hold."""


def check_maps(
    reader: MapsReader, names: Collection[str], report: Add, advance: Callable[[int], None]
) -> dict[str, int]:
    """Check the arrays ``names`` of a block, whose files are whole; the rows of every array that was checked.

    ``advance`` is called with the number of rows done.
    """
    known: dict[bytes, int] = {}
    for name in sorted(names):
        for start, stop in reader.pieces(name):
            rows = _read(reader, name, start, stop, report)
            if rows is not None and ARRAYS[name].dtype == "uint16":
                _check_heights(name, start, rows, report)
            if rows is not None and name == "ee_depth" and "ee_mask" in names:
                _check_distinct(reader, start, rows, known, report)
            advance(stop - start)
    return {name: reader.rows(name) for name in names}


def check_group(folder: Path, report: Add) -> None:
    """Check the group that holds the arrays of the block in ``folder``: other readers of Zarr begin there."""
    try:
        content = read_json(folder / MAPS / "zarr.json")
        good = content["zarr_format"] == 3 and content["node_type"] == "group"
    except (OSError, ValueError, KeyError, TypeError):
        good = False
    if not good:
        report("maps", f"{MAPS}/zarr.json", "", "it does not describe a group of Zarr version 3")


def _shard(name: str, row: int) -> str:
    """File inside the block that holds a row of an array."""
    form = ARRAYS[name]
    return "/".join((MAPS, name, "c", str(row // form.shard_rows), *("0" for _ in form.row)))


def _read(reader: MapsReader, name: str, start: int, stop: int, report: Add) -> npt.NDArray[Any] | None:
    try:
        return reader.read(name, start, stop)
    except IntegrityError as error:
        report("maps", _shard(name, start), f"rows {start} to {stop - 1}", error.message.rpartition(": ")[2])
        return None


def _check_heights(name: str, start: int, rows: npt.NDArray[Any], report: Add) -> None:
    if not len(rows) or rows.max() <= _HIGHEST:
        return
    tops = rows.reshape(len(rows), -1).max(axis=1)
    for bad, what in ((tops == MISSING, "a height is missing"), ((tops > _HIGHEST) & (tops < MISSING), "too high")):
        if bad.any():
            report("maps", _shard(name, start), rows_of(bad, start), what)


def _check_distinct(
    reader: MapsReader, start: int, depths: npt.NDArray[Any], known: dict[bytes, int], report: Add
) -> None:
    try:
        masks = reader.read("ee_mask", start, start + len(depths))
    except IntegrityError:
        return  # reported with the masks themselves
    for row, (depth, mask) in enumerate(zip(depths, masks, strict=True), start):
        digest = hashlib.sha256(depth.tobytes() + mask.tobytes()).digest()
        first = known.setdefault(digest, row)
        if first != row:
            report("maps", _shard("ee_depth", row), f"row {row}", f"the same end-effector map as row {first}")
