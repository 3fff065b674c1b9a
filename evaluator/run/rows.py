"""Rows of a results table as bytes: the same for the same values, whichever program wrote the file."""

from __future__ import annotations

import json
from typing import Any

import pyarrow as pa

from evaluator.run.merkle import leaf_hash

__all__ = ["canonical", "row_leaf", "row_leaves"]


def canonical(value: Any) -> bytes:
    """JSON with sorted names and no spaces, ASCII. Floats are written with the digits that give them back exactly."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode("ascii")


def row_leaf(row: dict[str, Any]) -> bytes:
    """Leaf hash of one row, as ``pyarrow.Table.to_pylist`` gives it."""
    return leaf_hash(canonical(row))


def row_leaves(table: pa.Table) -> list[bytes]:
    """Leaf hash of every row."""
    return [row_leaf(row) for row in table.to_pylist()]
