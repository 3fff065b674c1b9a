"""A machine with one published release in its home."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import register
from rema_data.testing import make_release


@pytest.fixture(scope="session")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """A release that is never written to."""
    return make_release(tmp_path_factory.mktemp("sealed"), tasks=("grasp", "push"), episodes=5)


@pytest.fixture
def machine(sealed: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Its folder: ``home``, ``manifests``, and the current one, which has nothing."""
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setattr("rema_data.doctor.releases.local_sources", lambda: (tmp_path / "releases",))
    (tmp_path / "manifests").mkdir()
    register(sealed.manifest)
    shutil.copytree(sealed.path, tmp_path / "home" / "releases" / "tiny")
    return tmp_path
