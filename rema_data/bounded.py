"""Tables and arrays that anybody may have written: what they take in memory is known before any of it is allocated.

A few stored bytes can stand for any number of them, so every reader looks at what a file announces, and compares it
with what its reader knows of it: a manifest, a log, or the format. Whatever is wrong with a file is a ValueError.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

__all__ = ["MOST_ROWS", "npz_arrays", "parquet_file", "parquet_table", "zstd_bytes"]

MOST_ROWS = 1 << 24
"""Rows of a table of which nothing is known."""
_MOST_BYTES = 1 << 30
_ROW_BYTES, _SLACK_BYTES = 1 << 12, 1 << 24
"""What a row of a table may take on average, and what a table may take besides."""

Array = npt.NDArray[Any]
Row = tuple[str, tuple[int, ...]]
"""Type of an array, and shape of one of its rows."""


def parquet_file(source: Path | bytes, most_rows: int = MOST_ROWS, **options: Any) -> pq.ParquetFile:
    """A table that can be read: raises ValueError where it announces too much, and what pyarrow raises."""
    file = pq.ParquetFile(io.BytesIO(source) if isinstance(source, bytes) else source, **options)
    about = file.metadata
    if about.num_rows > most_rows:
        raise ValueError(f"it has {about.num_rows:,} rows, where {most_rows:,} are the most")
    size = sum(about.row_group(n).total_byte_size for n in range(about.num_row_groups))
    room = min(_MOST_BYTES, _SLACK_BYTES + most_rows * _ROW_BYTES)
    if size > room or any(about.row_group(n).num_rows > most_rows for n in range(about.num_row_groups)):
        raise ValueError(f"it has {size:,} bytes in memory, where {room:,} are the most")
    return file


def parquet_table(source: Path | bytes, most_rows: int = MOST_ROWS, **options: Any) -> pa.Table:
    """A table of at most so many rows; raises as ``parquet_file``."""
    return parquet_file(source, most_rows, **options).read()


def zstd_bytes(data: bytes | memoryview, size: int, most_bytes: int) -> bytes:
    """What was compressed, ``size`` bytes; raises ValueError where these are more than ``most_bytes``, or not there."""
    if not 0 <= size <= most_bytes:
        raise ValueError(f"it has {size:,} bytes in memory, where {most_bytes:,} are the most")
    try:
        plain: bytes = pa.Codec("zstd").decompress(data, size, asbytes=True)
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"it cannot be decompressed: {error}") from error
    if len(plain) != size:
        raise ValueError(f"it has {len(plain):,} bytes, not {size:,}")
    return plain


def npz_arrays(data: bytes, rows: Mapping[str, Row], most_rows: Mapping[str, int]) -> dict[str, Array]:
    """The arrays of an npz file that have these types and shapes of a row, and at most so many rows.

    Raises ValueError where the file has others, or is no such file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sorted(archive.namelist()) != sorted(f"{name}.npy" for name in rows):
                raise ValueError("it has other arrays")
            return {name: _npy(archive, name, row, most_rows[name]) for name, row in rows.items()}
    except ValueError:
        raise
    except Exception as error:  # of zipfile, zlib and numpy's header, which is parsed as Python
        raise ValueError(f"it is not an archive of arrays: {error}") from error


def _npy(archive: zipfile.ZipFile, name: str, row: Row, most_rows: int) -> Array:
    with archive.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        if version != (1, 0):
            raise ValueError(f"{name} has a header of version {version}")
        shape, transposed, dtype = np.lib.format.read_array_header_1_0(file)
        wanted, tail = np.dtype(row[0]), row[1]
        if dtype != wanted or transposed or shape[1:] != tail or not 0 <= (shape or (-1,))[0] <= most_rows:
            raise ValueError(f"{name} is {dtype} {shape}, not {wanted} of at most {(most_rows, *tail)}")
        size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
        content = file.read(size + 1)
        if len(content) != size:
            raise ValueError(f"{name} has {len(content):,} bytes, not {size:,}")
    return np.frombuffer(content, dtype).reshape(shape)
