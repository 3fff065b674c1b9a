"""Imported by a worker of ``test_engines`` alone: what such a process looks like from inside."""

from __future__ import annotations

import os
import sys
from typing import Any

from evaluator.engines.child import THREAD_CAPS


def inside() -> dict[str, Any]:
    heavy = [name for name in ("torch", "pandas", "scipy", "pyarrow", "pybullet") if name in sys.modules]
    return {"caps": {name: os.environ.get(name) for name in THREAD_CAPS}, "heavy": heavy, "group": os.getpgrp()}
