"""Maps: what was written is read, and a hole or a changed byte is an error and never a flat table."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import google_crc32c
import numpy as np
import pytest

from rema_data.errors import IntegrityError, MissingFileError, StorageError
from rema_data.heights import MISSING, quantise
from rema_data.store import maps
from rema_data.store.maps import ARRAYS, MAPS, ArrayFormat, MapsReader, MapsWriter

ROWS = 21
LAST = {"scene": "0/0", "ee_depth": "0/0/0", "ee_mask": "0/0/0"}


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of two rows and shards of eight, so that a few rows are several files."""
    for name, form in ARRAYS.items():
        monkeypatch.setitem(ARRAYS, name, ArrayFormat(form.dtype, form.row, 2, 8, form.fill))


def example(name: str, rows: int = ROWS) -> np.ndarray:
    rng = np.random.default_rng(len(name))
    form = ARRAYS[name]
    array = np.zeros((rows, *form.row), form.dtype)
    array[..., 2:9, 2:9] = rng.integers(1, 200, (rows, *form.row[:-2], 7, 7))
    return array


def write(folder: Path) -> None:
    writer = MapsWriter(folder)
    for name in ARRAYS:
        writer.append(name, example(name))
    assert writer.close() == dict.fromkeys(ARRAYS, ROWS)


def shard(folder: Path, name: str, number: int) -> Path:
    return folder / MAPS / name / "c" / str(number) / LAST[name]


@pytest.mark.parametrize("name", ARRAYS)
def test_rows_come_back(name: str, tmp_path: Path) -> None:
    write(tmp_path)
    reader, whole = MapsReader(tmp_path), example(name)
    assert reader.rows(name) == ROWS
    for start, stop in ((0, ROWS), (0, 1), (7, 9), (20, 21), (5, 5)):
        assert np.array_equal(reader.read(name, start, stop), whole[start:stop])
    assert reader.pieces(name) == [(0, 8), (8, 16), (16, 21)]
    assert shard(tmp_path, name, 2).is_file()
    assert not shard(tmp_path, name, 3).exists()


def test_the_error_is_within_the_bound_that_the_array_states(tmp_path: Path) -> None:
    heights = np.random.default_rng(0).uniform(-0.01, 0.3, (4, 64, 64))
    writer = MapsWriter(tmp_path)
    writer.append("scene", quantise(heights))
    writer.close()
    stated = json.loads((tmp_path / MAPS / "scene" / "zarr.json").read_bytes())["attributes"]
    assert (stated["unit"], stated["height"]) == ("m", "value * step_m + offset_m")
    read = MapsReader(tmp_path).read("scene", 0, 4) * stated["step_m"] + stated["offset_m"]
    error = np.abs(read - heights).max()
    assert stated["max_error_m"] * 0.99 < error <= stated["max_error_m"] * (1 + 1e-9)


@pytest.mark.parametrize("name", ARRAYS)
def test_the_layout_is_the_documented_one(name: str, tmp_path: Path) -> None:
    write(tmp_path)
    described = json.loads((tmp_path / MAPS / name / "zarr.json").read_bytes())
    assert (described["zarr_format"], described["node_type"]) == (3, "array")
    assert described["fill_value"] == ARRAYS[name].fill
    assert described["chunk_grid"]["configuration"]["chunk_shape"] == [8, *ARRAYS[name].row]
    (sharding,) = described["codecs"]
    assert sharding["name"] == "sharding_indexed"
    inner = sharding["configuration"]
    assert inner["chunk_shape"] == [2, *ARRAYS[name].row]
    assert [codec["name"] for codec in inner["codecs"]] == ["bytes", "zstd", "crc32c"]
    assert [codec["name"] for codec in inner["index_codecs"]] == ["bytes", "crc32c"]
    assert inner["index_location"] == "end"


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_lost_shard_is_a_hole(name: str, number: int, tmp_path: Path) -> None:
    write(tmp_path)
    shard(tmp_path, name, number).unlink()
    with pytest.raises(IntegrityError, match=f"row {8 * number} is missing") as caught:
        MapsReader(tmp_path).read(name, 0, ROWS)
    assert caught.value.facts["path"].endswith(name)
    assert "rema verify" in caught.value.hint


def lose_chunk(path: Path, chunk: int, chunks: int = 4) -> None:
    """Mark an inner chunk as absent in the index at the end of a shard, with a right checksum."""
    data = path.read_bytes()
    size = 16 * chunks
    index = bytearray(data[-size - 4 : -4])
    assert google_crc32c.value(bytes(index)) == struct.unpack("<I", data[-4:])[0]
    index[16 * chunk : 16 * chunk + 16] = b"\xff" * 16
    path.write_bytes(data[: -size - 4] + index + struct.pack("<I", google_crc32c.value(bytes(index))))


@pytest.mark.parametrize("name", ARRAYS)
def test_a_lost_inner_chunk_is_a_hole(name: str, tmp_path: Path) -> None:
    write(tmp_path)
    lose_chunk(shard(tmp_path, name, 1), 2)
    reader = MapsReader(tmp_path)
    assert np.array_equal(reader.read(name, 0, 12), example(name)[:12])
    with pytest.raises(IntegrityError, match="row 12 is missing"):
        reader.read(name, 0, ROWS)
    with pytest.raises(IntegrityError, match="row 13 is missing"):
        reader.read(name, 13, 14)


@pytest.mark.parametrize("name", ARRAYS)
def test_a_flipped_bit_is_found(name: str, tmp_path: Path) -> None:
    write(tmp_path)
    path = shard(tmp_path, name, 1)
    data = path.read_bytes()
    for number, place in enumerate(np.linspace(0, len(data) - 1, 25, dtype=int)):
        path.write_bytes(data[:place] + bytes([data[place] ^ (1 << number % 8)]) + data[place + 1 :])
        with pytest.raises(IntegrityError, match="cannot be decoded|is missing"):
            MapsReader(tmp_path).read(name, 8, 16)


@pytest.mark.parametrize("keep", [0, 1, 50, -1, -40])
def test_a_truncated_shard_is_found(keep: int, tmp_path: Path) -> None:
    write(tmp_path)
    path = shard(tmp_path, "scene", 0)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(IntegrityError):
        MapsReader(tmp_path).read("scene", 0, 8)


def test_no_maps(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="there are no maps") as caught:
        MapsReader(tmp_path)
    assert "rema verify" in caught.value.hint


@pytest.mark.parametrize("data", [b"", b"{}", b"null", b"[", b"\xff\xfe", b'{"zarr_format": 3, "node_type": "group"}'])
def test_damaged_metadata_are_named(data: bytes, tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / MAPS / "ee_mask" / "zarr.json").write_bytes(data)
    with pytest.raises(IntegrityError, match=r"ee_mask is damaged"):
        MapsReader(tmp_path)


@pytest.mark.parametrize(("old", "new"), [(b'"uint16"', b'"uint32"'), (b"64", b"32")])
def test_an_array_of_another_kind_is_refused(old: bytes, new: bytes, tmp_path: Path) -> None:
    write(tmp_path)
    path = tmp_path / MAPS / "scene" / "zarr.json"
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(IntegrityError, match=r"scene is damaged"):
        MapsReader(tmp_path)


@pytest.mark.parametrize("fill", [b"68535", b"-1", b"0", b"null", b'"65535"'])
def test_an_array_with_another_fill_value_is_refused(fill: bytes, tmp_path: Path) -> None:
    """A missing row is known by it."""
    write(tmp_path)
    path = tmp_path / MAPS / "scene" / "zarr.json"
    path.write_bytes(path.read_bytes().replace(b'"fill_value": 65535', b'"fill_value": ' + fill))
    with pytest.raises(IntegrityError, match=r"scene is damaged: its fill value is"):
        MapsReader(tmp_path)


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / MAPS / "ee_depth" / "zarr.json").unlink()
    with pytest.raises(IntegrityError, match=r"ee_depth is damaged"):
        MapsReader(tmp_path)


def test_a_row_that_is_partly_missing_is_no_hole_but_no_height_either(tmp_path: Path) -> None:
    rows = example("scene", 2)
    rows[1, 5, 5] = MISSING
    writer = MapsWriter(tmp_path)
    writer.append("scene", rows)
    writer.close()
    assert np.array_equal(MapsReader(tmp_path).read("scene", 0, 2), rows)


def test_a_folder_with_maps_is_not_written_again(tmp_path: Path) -> None:
    write(tmp_path)
    with pytest.raises(Exception, match="exists"):
        MapsWriter(tmp_path)


def test_a_full_disk_is_a_storage_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = MapsWriter(tmp_path)
    writer.append("scene", example("scene", 3))

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(maps.zarr.Array, "append", full)
    with pytest.raises(StorageError, match="no space is left"):
        writer.close()
