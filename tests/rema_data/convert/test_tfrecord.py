"""TFRecord files and their examples; TensorFlow's own reader: benchmarks/rlds_reader.py."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data.convert.tfrecord import byte_lists, example, read_records, write_record


@given(st.dictionaries(st.text(max_size=20), st.lists(st.binary(max_size=300), max_size=4), max_size=4))
def test_lists_of_bytes_come_back(features: dict[str, list[bytes]]) -> None:
    others = {"_floats": np.arange(3, dtype=np.float32), "_integers": np.array([-1, 0, 2**40])}
    names = [name for name in features if name not in others]
    assert byte_lists(example({**features, **others}), names) == {name: features[name] for name in names}


def test_the_bytes_are_those_of_the_specification() -> None:
    """Written out by hand: a feature ``a`` with the number 300, whose varint has two bytes."""
    assert example({"a": np.array([300])}) == b"\x0a\x0d\x0a\x0b\x0a\x01a\x12\x06\x1a\x04\x0a\x02\xac\x02"


@given(st.lists(st.binary(max_size=100), max_size=5))
def test_records_come_back(records: list[bytes]) -> None:
    file = io.BytesIO()
    for record in records:
        write_record(file, record)
    file.seek(0)
    assert list(read_records(file, 100)) == records


@given(st.integers(0, 37), st.integers(1, 255))
def test_a_flipped_byte_is_found(place: int, flip: int) -> None:
    file = io.BytesIO()
    write_record(file, b"twenty-two bytes here.")
    data = bytearray(file.getvalue())
    data[place] ^= flip
    with pytest.raises(ValueError, match="damaged"):
        list(read_records(io.BytesIO(bytes(data)), 100))


@pytest.mark.parametrize("left", range(1, 38))
def test_a_truncated_record_is_found(left: int) -> None:
    file = io.BytesIO()
    write_record(file, b"twenty-two bytes here.")
    with pytest.raises(ValueError, match="damaged"):
        list(read_records(io.BytesIO(file.getvalue()[:left]), 100))


def test_a_record_is_not_read_before_its_size_is_known_to_be_possible() -> None:
    file = io.BytesIO()
    write_record(file, b"x" * 101)
    file.seek(0)
    with pytest.raises(ValueError, match="101 bytes, where 100 are the most"):
        list(read_records(file, 100))


@given(st.binary(max_size=60))
def test_what_is_not_an_example_is_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError):
        byte_lists(data, ["no such feature"])
