"""Repair hints are commands that work where they are printed."""

from __future__ import annotations

import errno
import json
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

from rema_data import repair


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A git checkout with two committed files."""
    root = tmp_path / "my clone"
    (root / "manifests").mkdir(parents=True)
    for name in ("a.json", "b c.json"):
        (root / "manifests" / name).write_text("{}")
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.example"]
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "files"]):
        subprocess.run([*git, *command], cwd=root, check=True)
    monkeypatch.chdir(root)
    return root


@pytest.mark.parametrize("folder", [".", "manifests", ".."])
def test_files_of_a_checkout_come_back(checkout: Path, monkeypatch: pytest.MonkeyPatch, folder: str) -> None:
    monkeypatch.chdir(checkout / folder)
    files = [checkout / "manifests" / name for name in ("a.json", "b c.json")]
    files[0].write_text("damaged")
    files[1].unlink()
    command = repair.checkout_command(*files)
    assert command is not None and command.startswith("git checkout -- ") == (folder == ".")
    subprocess.run(command, shell=True, check=True)
    assert [file.read_text() for file in files] == ["{}", "{}"]


def test_a_folder_of_a_checkout_comes_back(checkout: Path) -> None:
    for file in (checkout / "manifests").iterdir():
        file.unlink()
    assert repair.restore(checkout / "manifests") == "git checkout -- manifests"


def test_files_of_the_package_and_of_nobody(tmp_path: Path) -> None:
    assert repair.restore(tmp_path / "rema_data" / "_manifests" / "x.json") == repair.reinstall()
    assert repair.restore(tmp_path / "x.json") == f"copy {tmp_path}/x.json again from where it came from"


@pytest.mark.parametrize(
    ("recorded", "origin"),
    [
        (None, "rema"),
        ({"url": "file:///home/me/my%20clone", "dir_info": {}}, "'/home/me/my clone'"),
        ({"url": "https://host/rema.git", "vcs_info": {"vcs": "git"}}, "git+https://host/rema.git"),
    ],
)
def test_the_package_comes_from_where_it_came_before(
    monkeypatch: pytest.MonkeyPatch, recorded: object, origin: str
) -> None:
    class Installed:
        def read_text(self, name: str) -> str | None:
            return None if recorded is None else json.dumps(recorded)

    monkeypatch.setattr(metadata, "distribution", lambda name: Installed())
    assert repair.reinstall() == f"pip install --force-reinstall --no-deps {origin}"
    assert repair.upgrade().endswith(f": pip install --upgrade {origin}")


def test_a_disk() -> None:
    assert "it resumes" in repair.storage(errno.ENOSPC) and "ulimit -f" in repair.storage(errno.EFBIG)
    assert "writable" in repair.storage(errno.EACCES) and repair.storage(errno.ENAMETOOLONG).startswith("choose")
