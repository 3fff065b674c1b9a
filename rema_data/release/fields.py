"""Values of a manifest that was read: each check raises a ValueError or TypeError that says what is wrong."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from datetime import date
from itertools import pairwise
from typing import Any

__all__ = ["check_day", "check_order", "check_path", "record"]

_DAY = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}")


def check_path(path: str) -> None:
    """Raise where a path could lead out of a release's folder."""
    parts = path.split("/")
    climbs = any(part in ("", ".", "..") for part in parts)
    if climbs or "\\" in path or ":" in path or not path.isprintable() or len(path) > 512:
        raise ValueError(f"the path {path!r} does not stay inside the release")


def check_day(text: str) -> None:
    """Raise where a text is neither empty nor a day of the calendar."""
    try:
        good = text == "" or (_DAY.fullmatch(text) is not None and bool(date.fromisoformat(text)))
    except ValueError:
        good = False
    if not good:
        raise ValueError(f"published is {text!r}, not a day such as 2026-01-31")


def check_order(name: str, keys: Sequence[Any]) -> None:
    """Raise where keys are not ascending."""
    if any(later < earlier for earlier, later in pairwise(keys)):
        raise ValueError(f"the {name} are not in their order")


def record(kind: type, row: Any) -> Any:
    """A record from a JSON object with exactly its fields, each of its type."""
    if not isinstance(row, dict):
        raise ValueError(f"{row!r} is no object")
    fields = {item.name: str(item.type) for item in dataclasses.fields(kind)}
    if set(row) != set(fields):
        raise ValueError(f"an entry has the fields {sorted(row)}, not {sorted(fields)}")
    for name, wanted in fields.items():
        value = row[name]
        if wanted == "int":
            good = isinstance(value, int) and not isinstance(value, bool) and value >= 0
        elif wanted == "str":
            good = isinstance(value, str)
        else:
            good = isinstance(value, list) and all(isinstance(item, str) for item in value)
            value = tuple(value) if good else value
        if not good:
            raise ValueError(f"{name} is {value!r}")
        row = {**row, name: value}
    return kind(**row)
