"""The commands of the examples, as a user types them in a folder of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def python(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Python with some words, on one core; cache and runs are below ``cwd``."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=cwd,
        env={**os.environ, "REMA_HOME": str(cwd / "home"), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def example(name: str) -> str:
    """Path of a file in ``examples``."""
    return str(ROOT / "examples" / f"{name}.py")


def rema(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command line."""
    return python("-m", "evaluator.cli", *words, cwd=cwd)
