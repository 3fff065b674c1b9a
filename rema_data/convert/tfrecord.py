"""TFRecord files of ``tf.train.Example``, written and read without TensorFlow.

A record is its length (uint64), a masked CRC-32C of that, its bytes, and a masked CRC-32C of these. The bytes are a
protocol buffer: a map from names to lists of bytes, of float32 or of int64.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import BinaryIO

import google_crc32c
import numpy as np
import numpy.typing as npt

__all__ = ["Values", "byte_lists", "example", "read_records", "write_record"]

Values = Sequence[bytes] | npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""A list of an example: bytes, float32 (N,) or int64 (N,)."""

_BYTES, _FLOATS, _INTEGERS = 1, 2, 3
_NESTED = 2
"""Wire type of whatever has a length."""
_MOST_VARINT_BYTES = 10


def write_record(file: BinaryIO, data: bytes) -> None:
    """Append a record."""
    length = struct.pack("<Q", len(data))
    file.write(b"".join((length, _checksum(length), data, _checksum(data))))


def read_records(file: BinaryIO, most_bytes: int) -> Iterator[bytes]:
    """Records in order; ValueError where one is truncated, damaged, or longer than ``most_bytes``."""
    while head := file.read(12):
        if len(head) != 12 or _checksum(head[:8]) != head[8:]:
            raise ValueError("the length of a record is damaged")
        (length,) = struct.unpack("<Q", head[:8])
        if length > most_bytes:
            raise ValueError(f"a record has {length:,} bytes, where {most_bytes:,} are the most")
        data, check = file.read(length), file.read(4)
        if len(data) != length or _checksum(data) != check:
            raise ValueError("a record is damaged")
        yield data


def _checksum(data: bytes) -> bytes:
    plain = google_crc32c.value(data)
    return struct.pack("<I", ((plain >> 15 | plain << 17) + 0xA282EAD8) & 0xFFFFFFFF)


def example(features: Mapping[str, Values]) -> bytes:
    """An example, its features in the order of their names."""
    entries = (_field(1, _field(1, name.encode()) + _field(2, _feature(features[name]))) for name in sorted(features))
    return _field(1, b"".join(entries))


def _feature(values: Values) -> bytes:
    if not isinstance(values, np.ndarray):
        return _field(_BYTES, b"".join(_field(1, value) for value in values))
    if values.dtype == np.float32:
        return _field(_FLOATS, _field(1, values.astype("<f4").tobytes()))
    return _field(_INTEGERS, _field(1, b"".join(_varint(value & (1 << 64) - 1) for value in values.tolist())))


def _field(number: int, data: bytes) -> bytes:
    return bytes([number << 3 | _NESTED]) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def byte_lists(data: bytes, names: Sequence[str]) -> dict[str, list[bytes]]:
    """Lists of bytes of an example by name; ValueError where it is not an example, or has no such lists."""
    found: dict[str, list[bytes]] = {}
    for features in _fields(data):
        for entry in _fields(features):
            parts = list(_fields(entry))
            if len(parts) == 2 and (name := parts[0].decode(errors="replace")) in names:
                found[name] = [value for values in _fields(parts[1]) for value in _fields(values)]
    if missing := sorted(set(names) - found.keys()):
        raise ValueError(f"an example has no {missing[0]}")
    return found


def _fields(data: bytes) -> Iterator[bytes]:
    """Fields of a message, each of which has a length."""
    place = 0
    while place < len(data):
        tag, place = _read_varint(data, place)
        length, place = _read_varint(data, place)
        if tag & 7 != _NESTED or length > len(data) - place:
            raise ValueError("a message is damaged")
        yield data[place : place + length]
        place += length


def _read_varint(data: bytes, place: int) -> tuple[int, int]:
    value = 0
    for number, byte in enumerate(data[place : place + _MOST_VARINT_BYTES]):
        value |= (byte & 0x7F) << 7 * number
        if byte < 0x80:
            return value, place + number + 1
    raise ValueError("a number is damaged")
