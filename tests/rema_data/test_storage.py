"""Files are whole or not there, and what stands in the way is said in a sentence."""

from __future__ import annotations

import errno
import os
import resource
from pathlib import Path

import pytest

from rema_data.errors import StorageError
from rema_data.storage import write_atomic


def test_written_whole_and_nothing_else(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a" / "b.json", "text")
    write_atomic(tmp_path / "a" / "b.json", b"other")
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b.json"]
    assert (tmp_path / "a" / "b.json").read_bytes() == b"other"


@pytest.mark.parametrize(
    ("name", "words"),
    [("file/x", "is in the way|is a file"), ("n" * 300, "too long"), ("folder", "there is a folder")],
)
def test_paths_that_cannot_be(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(StorageError, match=words) as caught:
        write_atomic(tmp_path / name, "text")
    assert caught.value.hint
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


def test_size_limit_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomic(path, "old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(StorageError, match="larger than is allowed") as caught:
            write_atomic(path, "x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.facts["errno"] == errno.EFBIG
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["file"]
