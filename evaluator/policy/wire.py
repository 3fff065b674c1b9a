"""Frames between the evaluator and a policy: a small JSON header, then the bytes of its arrays. No pickles.

::

    frame   = length of header (4 bytes, big endian) | header (JSON, UTF-8) | array bytes, one after the other
    header  = {"op": ..., "arrays": [[name, dtype, shape, repeat], ...], ...}

``repeat`` counts a first axis that was sent once because all its entries are equal: tool-free end effectors and the set
of valid actions are the same in a whole batch. It is 1 where nothing was left out.

A policy may write anything to its end. What a header announces is therefore checked as Python integers before a byte of
an array is read: numpy parses more than names of types, and raises more than one kind of error.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.policy.contract import ObservationBatch
from rema_data.schema import Grip, Pinch, Placement, Situation, spec_from_dict, to_dict

__all__ = [
    "MAX_HEADER",
    "REPLIES",
    "TAGS",
    "Frame",
    "WireError",
    "batch_frame",
    "frame_parts",
    "read_frame",
    "read_question",
]

MAX_HEADER = 16 << 20
"""Longest header, bytes: room for the situations of a large batch."""
REPLIES = {"act": "acted", "maps": "mapped"}
"""Questions about a batch, and the replies to them."""
TAGS = ("privileged", "simulator", "adapted")
"""What the class of a policy says of itself: that it is shown the ground truth; that it carries a simulator; that it
was trained on situations that were changed as those of a suite are."""
_STEP = ("primitive", "embodiment", "task", "step")
"""What a question says of its step."""
_LENGTH = struct.Struct(">I")
_AXES = 8
_NUMBERS = ("i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8")
_DTYPES = frozenset({"|b1", "|i1", "|u1", *(order + number for order in "<>" for number in _NUMBERS)})
"""What may cross: numbers of 1 to 8 bytes, in either order of bytes."""

Array = npt.NDArray[Any]
Frame = tuple[dict[str, Any], dict[str, Array]]
"""Header and arrays."""
Read = Callable[[int], bytes | bytearray]


class WireError(Exception):
    """Bytes that are not a frame."""


def frame_parts(
    header: dict[str, Any], arrays: Mapping[str, tuple[Array, int]] | None = None
) -> Iterator[bytes | memoryview]:
    """The parts of a frame, ready to be written: a header for JSON, and arrays by name, each with its ``repeat``."""
    contiguous = {name: (np.ascontiguousarray(array), repeat) for name, (array, repeat) in (arrays or {}).items()}
    described = [[name, array.dtype.str, list(array.shape), repeat] for name, (array, repeat) in contiguous.items()]
    text = json.dumps({**header, "arrays": described}).encode()
    if len(text) > MAX_HEADER:
        raise WireError(f"header of {len(text)} bytes")
    yield _LENGTH.pack(len(text)) + text
    for array, _ in contiguous.values():
        if array.size:
            yield array.data.cast("B")


def read_frame(read: Read, max_header: int, max_bytes: int) -> Frame:
    """One frame from ``read(count)``, which answers exactly ``count`` bytes; arrays are writable and expanded.

    Raises WireError where the bytes are no frame, or announce more than ``max_header`` or ``max_bytes``.
    """
    (length,) = _LENGTH.unpack(read(_LENGTH.size))
    if length > max_header:
        raise WireError(f"header of {length} bytes")
    try:
        header = json.loads(bytes(read(length)))
    except (ValueError, RecursionError) as error:
        raise WireError(f"header is not JSON: {error}") from error
    entries = header.get("arrays") if isinstance(header, dict) else None
    if not isinstance(entries, list):
        raise WireError("header names no arrays")
    described = [_described(entry) for entry in entries]
    if len({name for name, *_ in described}) != len(described):
        raise WireError("header names an array twice")
    # An axis of length 0 counts as 1, so that the others count too.
    bounds = (dtype.itemsize * math.prod(max(size, 1) for size in shape) * n for _, dtype, shape, n in described)
    if sum(bounds) > max_bytes:
        raise WireError("arrays are too large")
    return header, {name: _array(read, dtype, shape, n) for name, dtype, shape, n in described}


def _described(entry: Any) -> tuple[str, np.dtype[Any], tuple[int, ...], int]:
    """An entry of ``arrays``, checked; no value in it is trusted to have the right type."""
    if not isinstance(entry, list) or len(entry) != 4:
        raise WireError("an array is not described by four values")
    name, dtype, shape, repeat = entry
    if not isinstance(name, str) or not isinstance(dtype, str) or dtype not in _DTYPES:
        raise WireError("an array has no name, or no type that may be sent")
    if not isinstance(shape, list) or len(shape) > _AXES or not all(_is_count(size) for size in shape):
        raise WireError("an array has no shape")
    if not _is_count(repeat) or repeat < 1 or (repeat > 1 and not shape):
        raise WireError("an array is repeated an invalid number of times")
    return name, np.dtype(dtype), tuple(shape), repeat


def _is_count(value: Any) -> bool:
    return type(value) is int and value >= 0  # neither True nor 2.0


def _array(read: Read, dtype: np.dtype[Any], shape: tuple[int, ...], repeat: int) -> Array:
    array = np.frombuffer(bytearray(read(dtype.itemsize * math.prod(shape))), dtype).reshape(shape)
    return np.repeat(array, repeat, axis=0) if repeat > 1 else array


def batch_frame(
    number: int, batch: ObservationBatch, situations: tuple[Situation, ...] | None, op: str = "act"
) -> Iterator[bytes | memoryview]:
    """The question ``number`` about this batch: ``op`` is one of ``REPLIES``."""
    header: dict[str, Any] = {"op": op, "number": number, **{name: getattr(batch, name) for name in _STEP}}
    if situations is not None:
        shown = (  # not what a suite changes
            one if one.variation is None else dataclasses.replace(one, variation=None) for one in situations
        )
        header["situations"] = [to_dict(situation) for situation in shown]
    arrays = {
        "scene": (batch.scene, 1),
        "end_effector": _once_if_equal(batch.end_effector),
        "valid": _once_if_equal(batch.valid),
    }
    return frame_parts(header, arrays)


def _once_if_equal(array: Array) -> tuple[Array, int]:
    """The first entry and how often it repeats, when all entries are equal; else the array itself."""
    count = len(array)
    if count > 1 and (array.strides[0] == 0 or all(np.array_equal(array[0], entry) for entry in array[1:])):
        return array[:1], count
    return array, 1


def read_question(header: dict[str, Any], arrays: dict[str, Array]) -> tuple[ObservationBatch, tuple[Situation, ...]]:
    """The batch of a question, and the situations that a privileged policy is shown."""
    fields: dict[str, Any] = {**arrays, **{name: header[name] for name in _STEP}}
    return ObservationBatch(**fields), tuple(_situation(row) for row in header.get("situations", ()))


def _situation(row: dict[str, Any]) -> Situation:
    target = Placement(**_with_spec(row["target"]))
    grips = tuple(Grip(**_with_spec(grip)) for grip in row["grips"])
    pinch = None if row["pinch"] is None else Pinch(**_with_spec(row["pinch"]))
    return Situation(row["task"], row["step"], target, grips, pinch)


def _with_spec(row: dict[str, Any]) -> dict[str, Any]:
    return {**row, "spec": spec_from_dict(row["spec"])}
