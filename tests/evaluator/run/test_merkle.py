"""The tree is that of RFC 6962: every leaf can be proved, and nothing else can."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.run.merkle import leaf_hash, merkle_proof, merkle_root, root_of_proof

LISTS = st.lists(st.binary(max_size=8), min_size=1, max_size=40)


def sha(*parts: bytes) -> bytes:
    return hashlib.sha256(b"".join(parts)).digest()


def test_roots_of_small_trees_as_the_rfc_defines_them() -> None:
    a, b, c = (leaf_hash(letter) for letter in (b"a", b"b", b"c"))
    assert a == sha(b"\0", b"a")
    assert merkle_root([]) == sha()
    assert merkle_root([a]) == a
    assert merkle_root([a, b, c]) == sha(b"\1", sha(b"\1", a, b), c)
    five = merkle_root([a, b, c, a, b])
    assert five == sha(b"\1", sha(b"\1", sha(b"\1", a, b), sha(b"\1", c, a)), b)


@given(LISTS, st.data())
def test_every_leaf_has_a_short_proof(entries: list[bytes], data: st.DataObject) -> None:
    leaves = [leaf_hash(entry) for entry in entries]
    position = data.draw(st.integers(0, len(leaves) - 1))
    path = merkle_proof(leaves, position)
    assert len(path) <= (len(leaves) - 1).bit_length()
    assert root_of_proof(leaves[position], position, len(leaves), path) == merkle_root(leaves)


@given(LISTS, st.data())
def test_no_other_leaf_position_count_or_path_is_proved(entries: list[bytes], data: st.DataObject) -> None:
    leaves = [leaf_hash(bytes([n]) + entry) for n, entry in enumerate(entries)]  # all different
    root, count = merkle_root(leaves), len(leaves)
    position = data.draw(st.integers(0, count - 1))
    path = merkle_proof(leaves, position)
    assert root_of_proof(leaf_hash(b"other"), position, count, path) != root
    other = data.draw(st.integers(-1, count))
    if other != position:
        assert root_of_proof(leaves[position], other, count, path) != root
    assert root_of_proof(leaves[position], position, count, [*path, leaves[0]]) is None
    for n in range(len(path)):
        bent = [*path[:n], leaf_hash(b"bent"), *path[n + 1 :]]
        assert root_of_proof(leaves[position], position, count, bent) != root
        assert root_of_proof(leaves[position], position, count, path[:n]) is None


def test_a_leaf_that_is_not_there() -> None:
    with pytest.raises(IndexError):
        merkle_proof([leaf_hash(b"a")], 1)
