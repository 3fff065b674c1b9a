"""A new folder is there whole, or not at all."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from rema_data.new_folder import new_folder, synced_files


def test_it_appears_when_all_of_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "below" / "made"
    with new_folder(path) as folder:
        (folder / "part").mkdir()
        (folder / "part" / "b").write_bytes(b"2")
        (folder / "a").write_bytes(b"1")
        assert not path.exists()
        hashed = [(file.relative_to(folder).as_posix(), sha256) for file, sha256 in synced_files(folder)]
    assert hashed == [(name, hashlib.sha256(data).hexdigest()) for name, data in (("a", b"1"), ("part/b", b"2"))]
    assert sorted(item.name for item in path.iterdir()) == ["a", "part"]
    assert [item.name for item in path.parent.iterdir()] == ["made"]


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with new_folder(tmp_path / "made") as folder:
            (folder / "a").write_bytes(b"1")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        fail()
    assert not list(tmp_path.iterdir())


def test_an_empty_folder_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "made"
    path.mkdir()
    with new_folder(path) as folder:
        (folder / "a").write_bytes(b"1")
    assert [item.name for item in path.iterdir()] == ["a"]
