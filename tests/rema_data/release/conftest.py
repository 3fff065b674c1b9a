"""A world without published releases, and one small release that all tests may read."""

from __future__ import annotations

from pathlib import Path

import pytest

from rema_data.release.folder import ReleaseFolder
from rema_data.testing import make_release


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty index of releases, an empty home, and a working folder without releases."""
    index = tmp_path / "manifests" / "datasets" / "index.json"
    index.parent.mkdir(parents=True)
    index.write_text('{"releases": []}\n')
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """Two tasks, one of them with a tool. Only to be read."""
    return make_release(tmp_path_factory.mktemp("tiny"), tasks=("grasp", "grasp_push"), episodes=10)
