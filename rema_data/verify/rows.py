"""Naming rows in a sentence."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["rows_of"]

_NAMED = 5


def rows_of(bad: npt.NDArray[Any], start: int = 0) -> str:
    """Which rows are true in a boolean array whose first one is row ``start``: all of a few, else the first ones."""
    rows = np.flatnonzero(bad) + start
    named = ", ".join(str(row) for row in rows[:_NAMED])
    if len(rows) == 1:
        return f"row {named}"
    return f"{len(rows)} rows: {named}" + (", ..." if len(rows) > _NAMED else "")
