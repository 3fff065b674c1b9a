"""Import PyBullet without the line that it writes to standard error."""

from __future__ import annotations

import importlib
import os
import sys

from evaluator.sim.bullet import require_bullet

__all__ = ["import_pybullet"]


def import_pybullet() -> None:
    """Import PyBullet with standard error closed: only the command writes there."""
    require_bullet()
    if sys.stderr is None:  # closed by the caller
        return
    sys.stderr.flush()
    kept = os.dup(2)
    silence = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(silence, 2)
        importlib.import_module("pybullet")
    finally:
        os.dup2(kept, 2)
        os.close(silence)
        os.close(kept)
