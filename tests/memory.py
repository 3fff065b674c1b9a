"""How much memory a test takes."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["little_memory"]

_UNIT_BYTES = 1 if sys.platform == "darwin" else 1024


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _UNIT_BYTES


@contextmanager
def little_memory(most_bytes: int = 300 << 20) -> Iterator[None]:
    """Fail where the peak of the process's memory rises by more than so much meanwhile."""
    before = _peak_bytes()
    yield
    assert _peak_bytes() - before < most_bytes
