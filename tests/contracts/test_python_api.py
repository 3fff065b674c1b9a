"""The README's example of the Python API runs as it is written."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_example(tmp_path: Path) -> None:
    example = re.search(r"```python\n(import evaluator\n.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    assert example
    (tmp_path / "example.py").write_text(example.group(1))
    environment = {**os.environ, "REMA_HOME": str(tmp_path / "home"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "example.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=180
    )
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"\d+ of 20\n", done.stdout)
