"""Maps in Parquet: each is a list of lists of numbers, as Hugging Face ``datasets`` stores arrays.

A file that somebody else may have written is looked at before it is decoded: a few bytes can stand for any number of
rows and values.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from rema_data.convert.pieces import PIECE_STEPS
from rema_data.convert.seal import damaged
from rema_data.storage import not_written

__all__ = ["array_feature", "feature", "nested", "read_nested", "with_features", "write_tables"]

Array = npt.NDArray[Any]
_MOST_EPISODE_STEPS = 64
"""Steps by which a row group may exceed a piece."""


def nested(array: Array) -> pa.Array:
    """An array (N, ...) as N nested lists."""
    values = pa.array(np.ascontiguousarray(array).reshape(-1))
    for size in reversed(array.shape[1:]):
        offsets = np.arange(len(values) // size + 1, dtype=np.int32) * np.int32(size)
        values = pa.ListArray.from_arrays(pa.array(offsets), values)
    return values


def feature(dtype: str) -> dict[str, Any]:
    """How ``datasets`` describes a column of plain values."""
    return {"dtype": dtype, "_type": "Value"}


def array_feature(shape: Sequence[int], dtype: str) -> dict[str, Any]:
    """How ``datasets`` describes a column of arrays of two or three axes."""
    return {"shape": list(shape), "dtype": dtype, "_type": f"Array{len(shape)}D"}


def with_features(schema: pa.Schema, features: Mapping[str, Any]) -> pa.Schema:
    """A schema that tells ``datasets`` which lists are arrays."""
    return schema.with_metadata({"huggingface": json.dumps({"info": {"features": features}})})


def write_tables(file: Any, tables: Iterable[pa.Table], maps: Iterable[str] = ()) -> None:
    """Write tables to an open file, a row group each, and read all columns but ``maps`` back.

    Raises StorageError where they are not what was written.
    """
    writer, written = None, []
    try:
        for table in tables:
            writer = writer or _writer(file, table.schema)
            writer.write_table(table, row_group_size=table.num_rows)
            written.append(table.drop_columns(list(maps)))
    finally:
        if writer is not None:
            writer.close()
    if written:
        file.seek(0)
        wanted = pa.concat_tables(written)
        try:
            found = pq.ParquetFile(file, page_checksum_verification=True).read(wanted.column_names)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise not_written(Path(file.name), str(error)) from error
        if not found.equals(wanted):
            raise not_written(Path(file.name))


def _writer(file: Any, schema: pa.Schema) -> pq.ParquetWriter:
    """A writer of tables with maps, every option fixed. Equal heights are what a dictionary is good at."""
    return pq.ParquetWriter(
        file,
        schema,
        version="2.6",
        compression="zstd",
        compression_level=3,
        use_dictionary=True,
        data_page_size=1 << 20,
        dictionary_pagesize_limit=1 << 20,
        write_statistics=False,
        write_page_checksum=True,
        store_schema=True,
    )


def read_nested(path: Path, columns: Mapping[str, tuple[int, ...]], most_rows: int) -> Iterator[dict[str, Array]]:
    """Columns of arrays of these shapes, a row group at a time; IntegrityError where the file has others."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            _check_size(file, columns, most_rows)
            for number in range(file.metadata.num_row_groups):
                table = file.read_row_group(number, columns=list(columns))
                yield {name: _unnested(table[name].combine_chunks(), shape) for name, shape in columns.items()}
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        raise damaged(path, str(error)) from error


def _check_size(file: pq.ParquetFile, columns: Mapping[str, tuple[int, ...]], most_rows: int) -> None:
    about = file.metadata
    if about.num_rows > most_rows:
        raise ValueError(f"it has {about.num_rows:,} rows, where {most_rows:,} are the most")
    for number in range(about.num_row_groups):
        group = about.row_group(number)
        parts = [group.column(n) for n in range(group.num_columns)]
        for name, shape in columns.items():
            found = [part.num_values for part in parts if part.path_in_schema.startswith(f"{name}.")]
            if group.num_rows > PIECE_STEPS + _MOST_EPISODE_STEPS or found != [group.num_rows * math.prod(shape)]:
                raise ValueError(f"row group {number} does not have {name} of the shape {shape}")


def _unnested(lists: pa.Array, shape: tuple[int, ...]) -> Array:
    count = len(lists)
    for _ in shape:
        lists = lists.flatten()
    if lists.null_count or len(lists) != count * math.prod(shape):
        raise ValueError(f"a map does not have the shape {shape}")
    array: Array = lists.to_numpy(zero_copy_only=True).reshape(count, *shape)
    return array
