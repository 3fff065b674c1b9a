"""The scripts that compare an export through another library's reader, without these libraries and with them."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign import digest
from rema_data.testing import make_release

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = {"lerobot": "lerobot", "minari": "minari", "rlds": "tensorflow_datasets", "hf": "datasets"}


def test_values_are_equal_with_their_types_and_shapes_only() -> None:
    array = np.arange(6, dtype=np.float32)
    assert digest(array) == digest(array.copy())
    others = [array + 1, array.astype(np.float64), array.reshape(2, 3), array[:5], "text", True]
    assert len({digest(value) for value in (array, *others)}) == 7
    assert digest("text") == digest(np.str_("text"))


@pytest.mark.parametrize("name", LIBRARIES)
def test_they_find_no_difference_or_say_what_to_install(name: str, tmp_path: Path) -> None:
    if name == "minari" and importlib.util.find_spec("minari") is not None:
        pytest.skip("what is played again must have been simulated, and a synthetic release was not")
    release = make_release(tmp_path, tasks=("grasp_push",), episodes=5)
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    words = ["--release", str(release.path), "--json", str(tmp_path / "found.json")]
    done = subprocess.run(
        [sys.executable, f"benchmarks/{name}_reader.py", *words],
        cwd=ROOT,
        env={**os.environ, "REMA_MANIFESTS": str(tmp_path / "manifests")},
        capture_output=True,
        text=True,
        timeout=300,
    )
    if importlib.util.find_spec(LIBRARIES[name]) is None:
        assert done.returncode == 1
        assert "if the library is missing, install it: python" in done.stderr
        return
    assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads((tmp_path / "found.json").read_text())["numbers"]["rows"]
    assert [row["different"] for row in rows] == [0] and rows[0]["steps"] == release.manifest.counts["steps"]
