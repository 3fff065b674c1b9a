"""Whole releases, made once a test session, and copies for every test to damage."""

from __future__ import annotations

from pathlib import Path

import pytest

from rema_data.release.folder import ReleaseFolder
from tests.rema_data.verify.damage import copy, make_whole, write_manifests


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """A release of all tasks that is never written to."""
    return make_whole(tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """A quick one, likewise."""
    return make_whole(tmp_path_factory.mktemp("small"), tasks=("grasp", "push"), episodes=10)


@pytest.fixture
def manifests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A manifests folder and a home of the test's own."""
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    return write_manifests(tmp_path / "manifests")


@pytest.fixture
def release(small: ReleaseFolder, manifests: Path, tmp_path: Path) -> ReleaseFolder:
    """A copy to be damaged."""
    return copy(small, tmp_path / "data")


@pytest.fixture
def downloaded(small: ReleaseFolder, manifests: Path, tmp_path: Path) -> ReleaseFolder:
    """A copy where `rema download` would have put it, of a release that is published."""
    from rema_data.release.registry import register

    register(small.manifest)
    return copy(small, tmp_path / "home" / "releases")
