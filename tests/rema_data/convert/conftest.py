"""A small release, and its exports; both are made once and never changed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.convert import ExportOptions, export_release
from rema_data.release.folder import ReleaseFolder
from rema_data.testing import make_release

TASKS = ("grasp", "grasp_grasp_push")


@pytest.fixture(scope="session")
def release(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """10 training and 2 validation episodes of two tasks, of one and of up to four steps."""
    return make_release(tmp_path_factory.mktemp("data"), tasks=TASKS, episodes=10)


@pytest.fixture(scope="session")
def exported(release: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("metres")
    export_release(release, folder)
    return folder


@pytest.fixture(scope="session")
def quantised(release: ReleaseFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("quantised")
    export_release(release, folder, options=ExportOptions("quantised"))
    return folder


@pytest.fixture
def export(exported: Path, tmp_path: Path) -> Path:
    """An export that may be changed."""
    return shutil.copytree(exported, tmp_path / "export")


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, with its bytes."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }
