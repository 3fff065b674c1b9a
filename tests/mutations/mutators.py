"""Inputs that nobody meant: bytes that a disk or a cable damaged, and well-formed content of another shape."""

from __future__ import annotations

import copy
import io
import json
import re
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

__all__ = ["FORGERIES", "damaged"]

Rng = np.random.Generator
_HUGE = '"@@HUGE@@"'
_DEEP = '"@@DEEP@@"'


def damaged(data: bytes, rng: Rng) -> bytes:
    """The bytes of a file after one to three accidents; never the same bytes."""
    out = data
    while out == data:
        for _ in range(int(rng.integers(1, 4))):
            out = _accident(out, rng)
    return out


def _accident(data: bytes, rng: Rng) -> bytes:
    size = len(data)
    at = int(rng.integers(size + 1))
    length = int(rng.integers(1, max(2, min(size, 4096) + 1)))
    junk = rng.bytes(length)
    match int(rng.integers(10)):
        case 0 if size:  # a bit
            flipped = bytearray(data)
            flipped[at % size] ^= 1 << int(rng.integers(8))
            return bytes(flipped)
        case 1 if size:  # a byte that text parsers know
            changed = bytearray(data)
            changed[at % size] = b'0123456789-.eE{}[]",:\\\n\x00\xff'[int(rng.integers(24))]
            return bytes(changed)
        case 2:
            return data[:at]
        case 3:
            return data[:at] + data[at + length :]
        case 4:
            return data[:at] + junk + data[at:]
        case 5:
            return data[:at] + junk + data[at + length :]
        case 6:
            return data[:at] + bytes(min(length, size - at)) + data[at + length :]
        case 7:
            return data[:at] + data[at : at + length] + data[at:]
        case 8:  # a digit
            digits = [match.start() for match in re.finditer(rb"\d", data[:100_000])]
            if digits:
                place = digits[int(rng.integers(len(digits)))]
                return data[:place] + b"%d" % rng.integers(10) + data[place + 1 :]
            return data + junk
        case _:  # words of an integer: lengths and offsets
            value = (0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)[int(rng.integers(6))]
            word = value.to_bytes(8, "little")[: (4, 8)[int(rng.integers(2))]]
            return data[:at] + word + data[at + len(word) :]


_STRANGE: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 255, 65_536, 2**31, 2**63, 2**64, -(2**63), 1e308, 0.5, -0.0),
    *(float("nan"), float("inf"), "", "x", "x" * 100_000, "\ud800", "\x00", "../../../etc/passwd", "1", "a/b", "é\n"),
    *([], {}, [None], [[]], {"": {}}, [1, "a", None], [0] * 10_000, {"a": [{}]}, "@@HUGE@@", "@@DEEP@@"),
)


def _forged(content: Any, rng: Rng) -> Any:
    """JSON content with one place changed."""
    root = [copy.deepcopy(content)]
    places: list[tuple[Any, Any]] = [(root, 0)]
    for parent, key in places:
        value = parent[key]
        if isinstance(value, dict):
            places += [(value, name) for name in value]
        elif isinstance(value, list):
            places += [(value, n) for n in range(min(len(value), 20))]
    parent, key = places[int(rng.integers(len(places)))]
    match int(rng.integers(8)):
        case 0 if isinstance(parent, dict):
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[f"{key}{'x' * int(rng.choice([1, 70_000]))}"] = parent.pop(key)
        case 2 if isinstance(parent, dict):
            parent["unknown"] = parent[key]
        case 3 if isinstance(parent, list) and parent is not root:
            parent.insert(0, parent[key])
        case 4 if isinstance(parent[key], int | float):
            parent[key] = parent[key] * int(rng.choice([-1, 2, 10**6, 10**12])) + int(rng.choice([-1, 0, 1]))
        case 5 if isinstance(parent[key], str):
            parent[key] = parent[key] + str(rng.choice([" ", "\n", "\x1b[2J", "x" * 1000, "/..", "é"]))
        case _:
            parent[key] = _STRANGE[int(rng.integers(len(_STRANGE)))]
    return root[0]


def _text(content: Any, **layout: Any) -> str:
    text = json.dumps(content, **layout)
    return text.replace(_HUGE, "9" * 5000).replace(_DEEP, "[" * 100_000 + "]" * 100_000)


def forged_json(data: bytes, rng: Rng) -> bytes:
    """JSON of another shape, laid out as rema does it."""
    content = _forged(json.loads(data), rng)
    indent = 1 if data[:3] == b"{\n " and data[3:4] == b'"' else 2 if data[:2] == b"{\n" else None
    end = "\n" if data.endswith(b"\n") else ""
    return f"{_text(content, indent=indent, ensure_ascii=bool(rng.integers(2)))}{end}".encode("utf-8", "surrogatepass")


def forged_journal(data: bytes, rng: Rng) -> bytes:
    """Lines with valid checksums, one of which has another shape."""
    lines = data.split(b"\n")[:-1]
    at = int(rng.integers(len(lines)))
    content = json.loads(lines[at])[1]
    payload = _text(_forged(content, rng), separators=(",", ":")).encode()
    lines[at] = b"[%d,%b]" % (zlib.crc32(payload), payload)
    return b"\n".join(lines) + b"\n"


def forged_toml(data: bytes, rng: Rng) -> bytes:
    """A plan with one value, one key or one line changed."""
    lines = data.decode().split("\n")
    assigned = [n for n, line in enumerate(lines) if "=" in line]
    at = assigned[int(rng.integers(len(assigned)))]
    name, value = (part.strip() for part in lines[at].split("=", 1))
    huge = "x" * 100_000
    strange = (
        *("", '""', "0", "-1", "true", "1e400", "nan", "2030-01-31", "[]", "{}", "[[1]]", '"../.."', f'"{huge}"'),
        *(str(2**63), str(2**70), "9" * 5000, "[" * 50_000, '"\\u0000"', '"\\u001b[2J"', "{ train = 0 }", "[1, 2]"),
        *('{ code = "random", checkpoint = "/" }', "{ train = 99999999999, val = 1 }", '["grasp", "grasp"]'),
        '"' + "a/" * 3000 + '"',
    )
    match int(rng.integers(6)):
        case 0:
            lines[at] = f"{name}{huge} = {value}"
        case 1:
            del lines[at]
        case 2:
            lines.insert(at, lines[at])
        case 3:
            lines[at] = f"{lines[at]}\nunknown = {value}"
        case _:
            lines[at] = f"{name} = {strange[int(rng.integers(len(strange)))]}"
    return "\n".join(lines).encode()


def forged_parquet(data: bytes, rng: Rng) -> bytes:
    """A table with other types, other values, or other rows."""
    table = pq.read_table(io.BytesIO(data))
    at = int(rng.integers(table.num_columns))
    field, column = table.schema.field(at), table.column(at)
    match int(rng.integers(7)):
        case 0:
            table = table.drop_columns([field.name])
        case 1:
            table = table.slice(0, table.num_rows // 2)
        case 2:
            table = pa.concat_tables([table, table])
        case 3:
            table = table.append_column(field.name + str(rng.choice(["", "x" * 5000])), column)
        case 4:
            table = table.set_column(at, field.name, pa.nulls(table.num_rows, field.type))
        case 5:
            kind = (pa.string(), pa.float64(), pa.int64(), pa.bool_(), pa.list_(pa.int8()))[int(rng.integers(5))]
            table = table.set_column(at, field.name, pa.nulls(table.num_rows, kind))
        case _:
            table = table.set_column(at, field.name, _other_values(field.type, table.num_rows, rng))
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def _other_values(kind: pa.DataType, count: int, rng: Rng) -> pa.Array:
    if pa.types.is_string(kind):
        return pa.array([str(rng.choice(["", "x" * 10_000, "grasp", "\x1b[2J", "é"]))] * count, kind)
    if pa.types.is_boolean(kind):
        return pa.array(rng.random(count) < 0.5, kind)
    if pa.types.is_floating(kind):
        return pa.array([float(rng.choice([np.nan, np.inf, -1e308, 0.0]))] * count, kind)
    limits = np.iinfo(kind.to_pandas_dtype())
    return pa.array([int((limits.min, limits.max, 0, 1)[int(rng.integers(4))])] * count, kind)


def forged_variation(data: bytes, rng: Rng) -> bytes:
    """A list of a suite with one place changed in what one of its scenarios changes."""
    table = pq.read_table(io.BytesIO(data))
    texts = table.column("variation").to_pylist()
    at = int(rng.integers(len(texts)))
    texts[at] = _text(_forged(json.loads(texts[at]), rng)).encode("utf-8", "surrogatepass").decode("utf-8", "replace")
    place = table.schema.get_field_index("variation")
    table = table.set_column(place, table.schema.field(place), pa.array(texts, pa.string()))
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def forged_npz(data: bytes, rng: Rng) -> bytes:
    """An archive with an array of another shape or type, one of them without the data that it announces."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = dict(archive)
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    array = arrays.pop(name)
    match int(rng.integers(6)):
        case 0:
            pass
        case 1:
            arrays[name] = array[: len(array) // 2]
        case 2:
            arrays[name] = array.astype(np.float64)
        case 3:
            arrays[name] = np.zeros(40_000_000, np.uint8)  # 40 kB compressed
        case 4:
            arrays[name] = array[None]
        case _:
            arrays[name] = np.broadcast_to(array.dtype.type(255), array.shape)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


FORGERIES: dict[str, Callable[[bytes, Rng], bytes]] = {
    "json": forged_json,
    "journal": forged_journal,
    "toml": forged_toml,
    "parquet": forged_parquet,
    "variation": forged_variation,
    "npz": forged_npz,
}
"""How content of another shape is made, by the kind of file."""
