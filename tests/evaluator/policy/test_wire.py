"""Frames: what is sent arrives, and anything else is a WireError, for every header."""

from __future__ import annotations

import dataclasses
import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.policy import PolicyHost
from evaluator.policy.wire import WireError, batch_frame, frame_parts, read_frame, read_question
from evaluator.scenarios import load_list
from rema_data.variation import Variation

from .batches import make_batch
from .conftest import REPLIES, WritePolicy
from .test_host_answers import LIMITS, reasons

MAX_BYTES = 1000


class Tape:
    """Bytes to read; past their end there are zeros without end, as a hostile policy would send them."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.handed = 0

    def read(self, count: int) -> bytes:
        assert 0 <= count <= MAX_BYTES + len(self.data)
        self.handed += count
        head, self.data = self.data[:count], self.data[count:]
        return head.ljust(count, b"\0")


def framed(header: Any) -> bytes:
    text = json.dumps(header).encode()
    return struct.pack(">I", len(text)) + text


odd = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([0, 1, 2, 7, 2**31, 2**63, 10**30, -1, float("inf"), float("nan"), 1e300, 2.0]),
    st.text(max_size=4),
)
anything = st.recursive(odd, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner))
dtypes = st.sampled_from(
    ["<f4", "|b1", ">i8", "<f8", "|O", "<f16", "|S5", "<M8[s]", "(1i4,i4", "i4,i4", "V9", "float32", "", "<c8"]
)
sizes = st.lists(odd | st.integers(0, 12), max_size=9)
entries = st.one_of(
    st.tuples(st.sampled_from(["answer", "b"]), dtypes, sizes, st.integers(-1, 3) | odd).map(list), anything
)
headers = st.one_of(anything, st.fixed_dictionaries({"op": anything, "arrays": st.lists(entries, max_size=3)}))


@given(headers)
def test_every_header_gives_a_frame_or_a_wire_error(header: Any) -> None:
    data = framed(header)
    tape = Tape(data)
    try:
        _, arrays = read_frame(tape.read, 1 << 20, MAX_BYTES)
    except WireError:
        assert tape.handed <= len(data)  # nothing of an array was read
        return
    assert sum(array.nbytes for array in arrays.values()) <= MAX_BYTES
    assert tape.handed <= len(data) + MAX_BYTES


@given(st.binary(max_size=60))
def test_bytes_that_are_not_a_header(data: bytes) -> None:
    with pytest.raises(WireError):
        read_frame(Tape(struct.pack(">I", len(data)) + data).read, 1 << 20, MAX_BYTES)


HOSTILE = {
    "an endless axis": ["answer", "<i8", [float("inf")], 1],
    "a type that numpy parses": ["answer", "(1i4,i4", [2], 1],
    "no repeats of very much": ["answer", "<i8", [2**40], 0],
    "nothing, in very large": ["answer", "<i8", [0, 10**30], 1],
    "a repeated scalar": ["answer", "<i8", [], 2],
    "an axis that is true": ["answer", "<i8", [True], 1],
}


@pytest.mark.parametrize("entry", HOSTILE.values(), ids=HOSTILE.keys())
def test_headers_that_numpy_would_misread(entry: list[Any]) -> None:
    with pytest.raises(WireError):
        read_frame(Tape(framed({"op": "acted", "arrays": [entry]})).read, 1 << 20, MAX_BYTES)


def test_a_malformed_reply_is_a_fault_and_the_evaluator_survives(write_policy: WritePolicy) -> None:
    frames = [framed({"op": "acted", "arrays": [entry]}) for entry in list(HOSTILE.values())[:2]]
    spec = write_policy(f"if n > 1: os.write(replies(), {frames!r}[n - 2])\nreturn good", top=REPLIES)
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        for count in (2, 3):
            answers = host.act(make_batch(count))
            assert reasons(answers) == ["ok"] * count  # asked one by one it behaves
        assert host.restarts == 2


def test_a_report_that_is_not_text_is_a_fault(write_policy: WritePolicy) -> None:
    spec = write_policy(
        """
        number = inspect.currentframe().f_back.f_locals["header"]["number"]
        nested = "[" * 300 + "]" * 300
        text = '{"op":"acted","arrays":[],"number":%d,"message":%s,"reason":%s,"where":1}' % (number, nested, nested)
        os.write(replies(), len(text).to_bytes(4, "big") + text.encode())
        time.sleep(60)
        """,
        top=f"import inspect\n{REPLIES}",
    )
    with PolicyHost(spec, None, "cpu", LIMITS) as host:
        assert reasons(host.act(make_batch(1))) == ["protocol"]


def test_a_batch_arrives_as_it_was_sent() -> None:
    batch = make_batch(3)
    header, arrays = read_frame(Tape(b"".join(map(bytes, batch_frame(5, batch, None)))).read, 1 << 20, 1 << 30)
    found, _ = read_question(header, arrays)
    assert header["number"] == 5 and (found.task, found.primitive) == (batch.task, batch.primitive)
    for name in ("scene", "end_effector", "valid"):
        assert np.array_equal(getattr(found, name), getattr(batch, name))
        assert getattr(found, name).flags.writeable


@pytest.mark.parametrize("dtype", ["bool", "uint8", ">i2", "float16", "float64", "uint64"])
def test_every_number_may_be_sent(dtype: str) -> None:
    array = np.arange(6).reshape(2, 3).astype(dtype)
    data = b"".join(map(bytes, frame_parts({"op": "x"}, {"answer": (array, 1), "twice": (array[:1], 2)})))
    _, arrays = read_frame(Tape(data).read, 1 << 20, MAX_BYTES)
    assert np.array_equal(arrays["answer"], array) and arrays["answer"].dtype == array.dtype
    assert np.array_equal(arrays["twice"], np.repeat(array[:1], 2, axis=0))


def test_nobody_is_told_what_a_suite_changes() -> None:
    """A privileged policy sees the true situation, but neither the axis nor the level."""
    situation = load_list("grasp").scenarios[0].last_situation()
    varied = dataclasses.replace(situation, variation=Variation("secret axis", 3, 0))
    sent = b"".join(batch_frame(1, make_batch(1), (varied,)))
    assert b"secret" not in sent and sent == b"".join(batch_frame(1, make_batch(1), (situation,)))
