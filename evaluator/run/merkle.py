"""A hash tree over a list: one hash for all of it, and proofs that one entry is in it, log2(N) hashes long.

The tree is that of RFC 6962 (Certificate Transparency): SHA-256, leaves and inner nodes distinguished by a first byte,
a last node without a neighbour moved up as it is.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

__all__ = ["HASH_BYTES", "leaf_hash", "merkle_proof", "merkle_root", "root_of_proof"]

HASH_BYTES = 32


def leaf_hash(content: bytes) -> bytes:
    """Hash of an entry."""
    return hashlib.sha256(b"\x00" + content).digest()


def _node(left: bytes, right: bytes) -> bytes:
    return hashlib.sha256(b"\x01" + left + right).digest()


def _parents(level: Sequence[bytes]) -> list[bytes]:
    pairs = [_node(level[n], level[n + 1]) for n in range(0, len(level) - 1, 2)]
    return [*pairs, level[-1]] if len(level) % 2 else pairs


def merkle_root(leaves: Sequence[bytes]) -> bytes:
    """Root over leaf hashes; of nothing, the hash of nothing."""
    if not leaves:
        return hashlib.sha256(b"").digest()
    level = list(leaves)
    while len(level) > 1:
        level = _parents(level)
    return level[0]


def merkle_proof(leaves: Sequence[bytes], position: int) -> list[bytes]:
    """The neighbours on the way from a leaf to the root, from the bottom up. Raises IndexError without such a leaf."""
    if not 0 <= position < len(leaves):
        raise IndexError(f"leaf {position} of {len(leaves)}")
    level, path = list(leaves), []
    while len(level) > 1:
        neighbour = position ^ 1
        if neighbour < len(level):
            path.append(level[neighbour])
        level, position = _parents(level), position // 2
    return path


def root_of_proof(leaf: bytes, position: int, count: int, path: Sequence[bytes]) -> bytes | None:
    """The root that a proof leads to, to be compared with a trusted one; None where it cannot be a proof.

    ``leaf`` is the hash of the entry at ``position`` of ``count`` entries, ``path`` comes from ``merkle_proof``.
    """
    if not 0 <= position < count:
        return None
    above = list(reversed(path))
    found = leaf
    while count > 1:
        if position ^ 1 < count:
            if not above:
                return None
            neighbour = above.pop()
            found = _node(neighbour, found) if position % 2 else _node(found, neighbour)
        position, count = position // 2, (count + 1) // 2
    return None if above else found
