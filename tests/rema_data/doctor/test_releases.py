"""The home folder, and the releases that are found."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from rema_data.doctor.machine import home
from rema_data.doctor.releases import local_releases
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST


def test_home_that_is_not_there_yet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "a" / "b"))
    found = home()
    assert (found.path, found.writable) == (str(tmp_path / "a" / "b"), True)
    assert 0 < found.free_bytes <= shutil.disk_usage(tmp_path).total
    assert not (tmp_path / "a").exists()


def test_home_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "a"))
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert not home().writable
    (tmp_path / "a").touch()
    monkeypatch.undo()
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "a"))
    assert not home().writable


def test_whole_release(machine: Path, sealed: ReleaseFolder) -> None:
    (found,) = local_releases()
    assert (found.name, found.path) == ("tiny", str(machine / "home" / "releases" / "tiny"))
    assert (found.identity, found.ok) == ("published", True)
    assert (found.blocks, found.blocks_total, found.bytes) == (4, 4, sealed.manifest.counts["bytes"])


def test_a_part_of_a_release(machine: Path, sealed: ReleaseFolder) -> None:
    """Without the manifest beside the data too: an interrupted download has none."""
    folder = machine / "home" / "releases" / "tiny"
    lost = sum(path.stat().st_size for path in (folder / "round-1" / "push").rglob("*") if path.is_file())
    shutil.rmtree(folder / "round-1" / "push")
    (folder / MANIFEST).unlink()
    (found,) = local_releases()
    assert (found.blocks, found.blocks_total, found.identity) == (2, 4, "published")
    assert found.bytes == sealed.manifest.counts["bytes"] - lost


@pytest.mark.parametrize(
    ("name", "content", "identity"),
    [
        ("tiny", lambda data: data.replace(b"Synthetic", b"Synthetik"), "not the published one"),
        ("other", lambda data: data.replace(b'"tiny"', b'"other"'), "not published"),
        ("renamed", lambda data: data, "the folder of tiny, renamed"),
        ("broken", lambda data: data[:100], "cannot be used"),
    ],
)
def test_identity(machine: Path, name: str, content: object, identity: str) -> None:
    folder = machine / "releases" / name
    folder.mkdir(parents=True)
    data = (machine / "home" / "releases" / "tiny" / MANIFEST).read_bytes()
    (folder / MANIFEST).write_bytes(content(data))  # type: ignore[operator]
    (found,) = [state for state in local_releases() if state.path == str(folder)]
    assert identity in found.identity
    assert found.ok == (identity == "not published")


def test_published_ones_come_in_the_order_of_their_publication(machine: Path) -> None:
    index = machine / "manifests" / "datasets" / "index.json"
    rows = json.loads(index.read_text())["releases"]
    index.write_text(json.dumps({"releases": [*rows, {"name": "alpha", "sha256": "0" * 64}]}))
    (machine / "releases" / "alpha").mkdir(parents=True)
    assert [state.name for state in local_releases()] == ["tiny", "alpha"]
