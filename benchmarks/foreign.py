"""What runs in the environment of another library, where rema is not installed: reading an export, step by step.

A script whose name ends in ``_reader.py`` runs twice: here, where it exports a release and knows what must come out
(``benchmarks.readers``), and with ``--there FOLDER`` under the Python of that environment. It needs NumPy alone.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["THERE", "digest", "main_there", "runs_there", "step_digest"]

THERE = "--there"

Steps = Iterator[Mapping[str, Any]]


def digest(value: Any) -> str:
    """Of type, shape and content of an array, a number or a text."""
    array = np.asarray(value)
    text = array.astype("U") if array.dtype.kind in "OSU" else array
    about = f"{'text' if text is not array else array.dtype.str} {array.shape}".encode()
    content = json.dumps(text.tolist()).encode() if text is not array else np.ascontiguousarray(array).tobytes()
    return hashlib.sha256(about + content).hexdigest()[:16]


def step_digest(step: Mapping[str, Any]) -> str:
    """Of all values of a step by their names: a short text, as a release has many steps."""
    return digest(sorted(f"{name} {digest(value)}" for name, value in step.items()))


def runs_there() -> bool:
    """Whether this process is the one in the other environment."""
    return len(sys.argv) == 4 and sys.argv[1] == THERE


def main_there(read: Callable[[Path], tuple[Steps, Callable[[], dict[str, Any]]]]) -> int:
    """Read an export with the other library, and write what was seen as JSON.

    ``read`` gives the steps of a dataset as values by name, and a function that is called after the last of them for
    further facts.
    """
    folder, target = Path(sys.argv[2]), Path(sys.argv[3])
    steps, facts = read(folder)
    found, seconds = [], 0.0
    while True:
        start = time.perf_counter()
        step = next(steps, None)
        seconds += time.perf_counter() - start
        if step is None:
            break
        found.append(step_digest(step))
    target.write_text(json.dumps({"steps": found, "seconds": seconds, **facts()}))
    return 0
