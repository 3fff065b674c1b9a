"""A fake installation: manifests with small lists, and a home of its own for caches."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.evaluator.fakes import write_fake_list

PUBLISHED = Path(__file__).resolve().parents[2] / "manifests" / "published"


@pytest.fixture
def fake_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with ``manifests`` (300 scenarios of two tasks) and an empty cache, named by the environment."""
    for task in ("grasp", "grasp_grasp_push"):
        write_fake_list(tmp_path / "manifests", task, 300)
    shutil.copytree(PUBLISHED, tmp_path / "manifests" / "published")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    return tmp_path
