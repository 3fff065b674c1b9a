"""JSON that anybody may have written: whatever is wrong with it is a ValueError."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["bounded_file", "checked_digest", "parse_json", "read_json", "with_digest"]

_MOST_BYTES = 1 << 26
_DIGEST = "content_sha256"


def parse_json(data: bytes | str) -> Any:
    """What JSON says; raises ValueError where it is none, is not UTF-8, or is nested too deeply to be read."""
    try:
        return json.loads(data)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def bounded_file(path: Path, most_bytes: int = _MOST_BYTES) -> bytes:
    """Content of a file; raises ValueError where it has more than ``most_bytes``, and OSError."""
    with path.open("rb") as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(f"it has more than {most_bytes:,} bytes")
    return data


def read_json(path: Path) -> Any:
    """What a JSON file says; raises OSError, and ValueError where it cannot be used."""
    return parse_json(bounded_file(path))


def with_digest(content: Mapping[str, Any]) -> dict[str, Any]:
    """An object with a sha256 of all its fields, so that damage shows: see ``checked_digest``."""
    return {**content, _DIGEST: _digest(content)}


def checked_digest(content: Any) -> Any:
    """An object without its sha256; raises ValueError where that is of other fields. One without passes as it is."""
    if not isinstance(content, dict) or _DIGEST not in content:
        return content
    plain = {name: value for name, value in content.items() if name != _DIGEST}
    if content[_DIGEST] != _digest(plain):
        raise ValueError(f"its fields are not those of its {_DIGEST}")
    return plain


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
