"""examples/train.py: what cannot be done is a sentence and an exit code, as of `rema`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("words", "sentence", "mend"),
    [
        (("--release", "nosuch"), "'nosuch' is neither a published release nor a folder", "published releases: "),
        (("--release", "rema-sample", "--batch-size", "1"), "a batch of 1 cannot hold", "use a batch of 2 or more"),
    ],
)
def test_bad_input_is_a_sentence(words: tuple[str, ...], sentence: str, mend: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples/train.py"), *words],
        cwd=tmp_path,
        env={**os.environ, "REMA_HOME": str(tmp_path / "home"), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(sentence) and mend in done.stderr and "Traceback" not in done.stderr
