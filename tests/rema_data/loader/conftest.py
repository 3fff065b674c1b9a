"""One release that all tests read, decoded once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import rema_data
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockKey
from rema_data.testing import make_release

TASKS = ("grasp", "grasp_push", "grasp_grasp_push")


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
def sealed(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """A release of three tasks and two rounds. Only to be read."""
    root = tmp_path_factory.mktemp("releases")
    return make_release(root, tasks=TASKS, rounds=(1, 2), episodes=10, seed=3, success=0.6)


@pytest.fixture(scope="session")
def release(sealed: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> rema_data.Release:
    """The same, opened."""
    return rema_data.Release(sealed, cache=tmp_path_factory.mktemp("decoded"))


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """A quick release. Only to be copied."""
    return make_release(tmp_path_factory.mktemp("pristine"), tasks=("grasp", "push"), episodes=5)


@pytest.fixture
def small(places: Path, pristine: ReleaseFolder) -> ReleaseFolder:
    """A copy of the quick release, to be damaged."""
    copy = ReleaseFolder(pristine.manifest, places / "data")
    shutil.copytree(pristine.path, copy.path, copy_function=shutil.copyfile)
    return copy


KEYS = [BlockKey(number, task, split) for number in (1, 2) for task in TASKS for split in ("train", "val")]
