"""The script that compares an export through robomimic's reader, with it and without it."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

from rema_data.testing import make_release

ROOT = Path(__file__).resolve().parents[2]


def test_it_finds_no_difference_or_says_what_to_install(tmp_path: Path) -> None:
    release = make_release(tmp_path, tasks=("grasp_push",), episodes=5)
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    words = ["--release", str(release.path), "--json", str(tmp_path / "found.json")]
    done = subprocess.run(
        [sys.executable, "benchmarks/robomimic_reader.py", *words],
        cwd=ROOT,
        env={**os.environ, "REMA_MANIFESTS": str(tmp_path / "manifests")},
        capture_output=True,
        text=True,
        timeout=120,
    )
    if importlib.util.find_spec("robomimic") is None:
        assert done.returncode == 1
        assert "pip install --no-deps robomimic" in done.stderr
        return
    assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads((tmp_path / "found.json").read_text())["numbers"]["rows"]
    assert [(row["split"], row["different"]) for row in rows] == [("train", 0), ("val", 0)]
    assert sum(row["steps"] for row in rows) == release.manifest.counts["steps"]
