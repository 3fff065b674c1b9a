"""Small files that stand for much memory are refused by what they announce, before any of it is taken."""

from __future__ import annotations

import io
import json
import resource
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rema_data.bounded import npz_arrays, parquet_table, zstd_bytes
from rema_data.errors import InputError, IntegrityError
from rema_data.json_files import bounded_file, checked_digest, parse_json, with_digest
from rema_data.release.folder import ReleaseFolder
from rema_data.store.columns import STEP_COLUMNS, arrow_schema
from rema_data.store.keys import BlockKey
from rema_data.store.maps import MapsReader
from rema_data.testing import make_block, make_release
from rema_data.validation import validated

ROWS = {"scene": ("uint16", (64, 64)), "which": ("uint32", ())}
MOST = {"scene": 4, "which": 4}


@contextmanager
def little_memory(most_kb: int = 200_000) -> Iterator[None]:
    """Fail where the process takes so much more memory meanwhile."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < most_kb


def long_table(schema: pa.Schema, rows: int) -> bytes:
    """A table of equal rows: a few bytes for any number."""
    columns = []
    for field in schema:
        value = "" if pa.types.is_string(field.type) else False if pa.types.is_boolean(field.type) else 0
        columns.append(pa.chunked_array([pa.repeat(pa.scalar(value, field.type), 100_000)] * (rows // 100_000)))
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns, schema=schema), buffer, compression="zstd")
    return buffer.getvalue()


def test_a_table_has_no_more_rows_than_its_reader_expects(tmp_path: Path) -> None:
    data = long_table(pa.schema({"a": pa.int8(), "b": pa.bool_()}), 2_000_000)
    assert len(data) < 20_000
    with little_memory(), pytest.raises(ValueError, match=r"2,000,000 rows, where 100 are the most"):
        parquet_table(data, 100)
    assert parquet_table(data, 2_000_000).num_rows == 2_000_000


def test_a_table_has_no_wider_rows_than_its_reader_expects() -> None:
    buffer = io.BytesIO()
    wide = pa.array([bytes(3_000_000)] * 10, pa.binary())
    pq.write_table(pa.table({"a": wide}), buffer, compression="zstd", use_dictionary=False)
    assert len(buffer.getvalue()) < 20_000
    with pytest.raises(ValueError, match="bytes in memory"):
        parquet_table(buffer.getvalue(), 10)


def test_a_block_has_the_rows_of_its_manifest(tmp_path: Path) -> None:
    made = make_release(tmp_path, tasks=("grasp",), episodes=5)
    (block, *_) = made.manifest.blocks
    path = made.block(block).folder / "steps.parquet"
    path.chmod(0o644)
    path.write_bytes(long_table(arrow_schema(STEP_COLUMNS, 1), 1_000_000))
    assert path.stat().st_size < 300_000
    with little_memory(), pytest.raises(IntegrityError, match=f"1,000,000 rows, where {2 * block.steps + 1000:,} are"):
        ReleaseFolder(made.manifest, tmp_path).block(block).steps()


def archive(**members: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return buffer.getvalue()


def array(shape: str, content: bytes = b"", kind: str = "<u2", order: str = "False") -> bytes:
    """A .npy file with any header."""
    header = f"{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + content


WHICH = array("(2,)", bytes(8), "<u4")
NPZ: dict[str, Callable[[], bytes]] = {
    "announces 16 GiB": lambda: archive(scene=array(f"({2**21}, 64, 64)"), which=WHICH),
    "announces more than an integer": lambda: archive(scene=array(f"({2**70}, 64, 64)"), which=WHICH),
    "holds 200 MB of zeros": lambda: archive(scene=array("(2, 64, 64)", bytes(200_000_000)), which=WHICH),
    "holds less than it announces": lambda: archive(scene=array("(2, 64, 64)", bytes(100)), which=WHICH),
    "another type": lambda: archive(scene=array("(2, 64, 64)", bytes(65_536), "<f8"), which=WHICH),
    "objects": lambda: archive(scene=array("(2, 64, 64)", b"", "|O"), which=WHICH),
    "other order": lambda: archive(scene=array("(2, 64, 64)", bytes(16_384), order="True"), which=WHICH),
    "no rows at all": lambda: archive(scene=array("()", bytes(2)), which=WHICH),
    "negative": lambda: archive(scene=array("(-1, 64, 64)"), which=WHICH),
    "code in the header": lambda: archive(scene=array("(print(1), 64, 64)"), which=WHICH),
    "an array too few": lambda: archive(which=WHICH),
    "an array too many": lambda: archive(scene=array("(2, 64, 64)", bytes(16_384)), which=WHICH, more=WHICH),
    "no archive": lambda: b"PK\x03\x04 something else",
    "nothing": lambda: b"",
}


@pytest.mark.parametrize("case", NPZ)
def test_archives_of_other_arrays(case: str) -> None:
    data = NPZ[case]()
    assert len(data) < 400_000
    with little_memory(), pytest.raises(ValueError):
        npz_arrays(data, ROWS, MOST)


def test_an_archive_comes_back() -> None:
    scene = np.arange(2 * 64 * 64, dtype=np.uint16).reshape(2, 64, 64)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, scene=scene, which=np.array([1, 0], np.uint32))
    found = npz_arrays(buffer.getvalue(), ROWS, MOST)
    assert np.array_equal(found["scene"], scene) and found["which"].tolist() == [1, 0]


def test_compressed_bytes_have_the_size_that_they_name() -> None:
    packed = pa.Codec("zstd").compress(bytes(50_000_000), asbytes=True)
    assert len(packed) < 10_000
    for size in (2**62, -1, 1001):
        with pytest.raises(ValueError, match="1,000 are the most"):
            zstd_bytes(packed, size, 1000)
    for damaged in (packed, packed[:-5], b"", b"something else"):
        with little_memory(), pytest.raises(ValueError):
            zstd_bytes(damaged, 1000, 1000)
    assert zstd_bytes(packed, 50_000_000, 1 << 30) == bytes(50_000_000)


def inner(content: Any) -> Any:
    return content["codecs"][0]["configuration"]


CHANGES: dict[str, Callable[[Any], Any]] = {
    "rows": lambda content: content["shape"].__setitem__(0, 4_000_000_000),
    "negative rows": lambda content: content["shape"].__setitem__(0, -4),
    "no number of rows": lambda content: content["shape"].__setitem__(0, "4"),
    "shard": lambda content: content["chunk_grid"]["configuration"]["chunk_shape"].__setitem__(0, 8192 * 100_000),
    "chunk": lambda content: inner(content)["chunk_shape"].__setitem__(0, 8192),
    "codec": lambda content: inner(content)["codecs"][1].update(name="gzip"),
    "codecs": lambda content: inner(content)["codecs"].insert(1, {"name": "gzip", "configuration": {"level": 1}}),
    "no codecs": lambda content: content.update(codecs=[]),
    "type": lambda content: content.update(data_type="float64"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_maps_are_stored_as_a_release_stores_them(case: str, tmp_path: Path) -> None:
    make_block(tmp_path, BlockKey(1, "grasp", "train"), 4)
    path = tmp_path / "maps.zarr" / "scene" / "zarr.json"
    content = json.loads(path.read_text())
    CHANGES[case](content)
    path.write_text(json.dumps(content))
    with little_memory(), pytest.raises(IntegrityError, match="array .*scene is damaged"):
        MapsReader(tmp_path)


def test_json_that_no_parser_survives(tmp_path: Path) -> None:
    for data in (b"[" * 100_000, b'{"a":' * 50_000, b"9" * 5000, b"\xff", b"", b"{"):
        with pytest.raises(ValueError):
            parse_json(data)
    deep: object = "end"
    for _ in range(5000):
        deep = [deep]
    with pytest.raises(InputError, match="x.json"):
        validated(list[int], deep, "x.json")
    path = tmp_path / "long.json"
    path.write_bytes(bytes(101))
    with pytest.raises(ValueError, match="more than 100 bytes"):
        bounded_file(path, 100)


def test_a_digest_of_the_content() -> None:
    content = {"a": [1, 0.5, None], "b": {"c": "é"}}
    assert checked_digest(with_digest(content)) == content == checked_digest(content)
    for change in ({"a": [1, 0.25, None]}, {"d": 1}, {"content_sha256": "0"}):
        with pytest.raises(ValueError, match="content_sha256"):
            checked_digest(with_digest(content) | change)
