"""What a parser is to a trial, and when two results are the same."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

__all__ = ["Again", "Parser", "described"]


@dataclass(frozen=True)
class Parser:
    """A parser and a whole input for it."""

    name: str
    make: Callable[[Path], None]  # writes the whole input below an empty folder
    read: Callable[[Path], Any]  # what the product reads there
    damage: tuple[str, ...]  # globs of the files that are damaged
    forge: Mapping[str, str] = field(default_factory=dict)  # globs of files that are forged, and how
    reseal: Callable[[Path, Path], None] | None = None  # after a forgery of a file: as somebody who knows the format
    slow: int = 1  # the fraction of a small number of inputs that it gets
    checked: bool = True  # whether anything tells right content from other content: not of a file that people edit


class Again(dict[str, Any]):
    """What was read, part by part; a part that is missing is made again by the product, so it may be missing."""

    def agrees(self, whole: Mapping[str, Any]) -> bool:
        """Whether every part that is there is the one of the whole input."""
        return all(name in whole and described(whole[name]) == described(value) for name, value in self.items())


def described(value: Any) -> str:
    """Text that is equal for equal content."""
    if isinstance(value, pa.Table):
        return f"{value.schema.names} {value.schema.types} {value.to_pydict()!r}"
    if hasattr(value, "numpy") and hasattr(value, "dtype"):
        value = value.detach().numpy()
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {described(item)}' for key, item in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(described, value))}]"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return described({item.name: getattr(value, item.name) for item in dataclasses.fields(value)})
    return repr(value)
