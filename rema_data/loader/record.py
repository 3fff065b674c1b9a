"""The record of a decoded cache, ``cache.json``: what its files must be, and whether they are.

Opening looks at sizes and headers, which takes a millisecond; ``damaged_files`` reads every byte.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from rema_data.json_files import read_json
from rema_data.loader.decode import MAP_ARRAYS
from rema_data.loader.index import INDEX_DTYPE
from rema_data.storage import file_sha256, write_atomic

__all__ = ["CACHE_VERSION", "damaged_files", "has_digests", "is_whole", "read_record", "write_record"]

CACHE_VERSION = 1
_RECORD = "cache.json"
_ROWS: dict[str, tuple[Any, tuple[int, ...]]] = {**MAP_ARRAYS, "index": (INDEX_DTYPE, ())}
"""Type and shape of one row of every file, by its name without ``.npy``."""
_JOBS = 2


def write_record(folder: Path, files: Sequence[Path], about: Mapping[str, Any]) -> None:
    """Write the record of a cache whose ``files`` are finished; ``about`` is added to it."""
    with ThreadPoolExecutor(_JOBS) as pool:
        digests = dict(zip((file.name for file in files), pool.map(_sha256, files), strict=True))
    sizes = {file.name: file.stat().st_size for file in files}
    record = {"version": CACHE_VERSION, **about, "files": sizes, "digests": digests}
    write_atomic(folder / _RECORD, json.dumps(record, indent=1) + "\n")


def read_record(folder: Path) -> dict[str, Any]:
    """The record of a cache. Raises OSError, ValueError, KeyError or TypeError where it cannot be read."""
    record = read_json(folder / _RECORD)
    if record["version"] != CACHE_VERSION:
        raise ValueError(f"the cache has version {record['version']}")
    return dict(record)


def is_whole(folder: Path) -> bool:
    """Whether a cache is there, with all its files in their sizes and under readable headers."""
    try:
        sizes = read_record(folder)["files"]
        return all(os.stat(folder / name).st_size == size for name, size in sizes.items()) and all(
            _has_header(folder / f"{name}.npy") for name in _ROWS
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def has_digests(folder: Path) -> bool:
    """Whether the content of a cache can be checked: those that an earlier rema made have no checksums."""
    try:
        return isinstance(read_record(folder).get("digests"), dict)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def damaged_files(folder: Path) -> tuple[str, ...]:
    """Files of a cache whose content has changed since it was written; empty where there are no checksums."""
    if not has_digests(folder):
        return ()
    wanted = read_record(folder)["digests"]
    paths = [folder / name for name in wanted]
    with ThreadPoolExecutor(_JOBS) as pool:
        return tuple(
            path.name for path, got in zip(paths, pool.map(_sha256, paths), strict=True) if got != wanted[path.name]
        )


def _sha256(path: Path) -> str:
    """Of a file; empty where it cannot be read."""
    try:
        return file_sha256(path)
    except OSError:
        return ""


def _has_header(path: Path) -> bool:
    """Whether an array is the one that its file is named for, as long as its file."""
    dtype, row = _ROWS[path.stem]
    try:
        array = np.lib.format.open_memmap(path, mode="r")
    except Exception:  # numpy parses a header as Python: damaged ones raise whatever that can raise
        return False
    fits = array.dtype == dtype and array.shape[1:] == row and bool(array.flags.c_contiguous)
    return fits and array.ndim > 0 and array.offset + array.nbytes == path.stat().st_size
