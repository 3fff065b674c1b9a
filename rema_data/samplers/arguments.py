"""Checks of what a sampler is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rema_data.errors import InputError
from rema_data.samplers.strata import column_of

__all__ = ["one_of", "refuse_mixed_splits", "whole"]


def whole(name: str, value: Any, least: int) -> int:
    """A whole number from ``least`` up; raises InputError where it is not one."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(
            f"{name}={value!r} is not a whole number from {least} up", hint=f"give {name} as such a number"
        )
    return int(value)


def one_of(name: str, value: Any, choices: Sequence[Any]) -> None:
    """Raise InputError where a value is not one of the choices."""
    if value not in choices:
        raise InputError(f"{name}={value!r} is unknown", hint=f"use one of {', '.join(map(repr, choices))}")


def refuse_mixed_splits(table: Any) -> None:
    """Raise InputError where a table has rows of more than one ``split``."""
    if "split" not in table:
        return
    splits = sorted(map(str, column_of(table, "split").unique().tolist()))
    if len(splits) > 1:
        raise InputError(
            f"the table mixes the splits {', '.join(splits)}: what is learned from cannot be validated on",
            hint='select one, for example release.steps(split="train")',
            splits=tuple(splits),
        )
