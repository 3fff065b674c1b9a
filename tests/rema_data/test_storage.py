"""Files are whole or not there, and what stands in the way is said in a sentence."""

from __future__ import annotations

import errno
import io
import os
import resource
import tempfile
from pathlib import Path
from typing import Any

import pytest

from rema_data import environment, storage
from rema_data.errors import MissingFileError, StorageError
from rema_data.storage import rema_home, storage_errors, write_atomic


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


@pytest.mark.parametrize("written", ["out/a/b", "out", ".", ".out.writing-abc/out/a"])
def test_a_file_that_is_read_is_not_what_cannot_be_written(tmp_path: Path, written: str) -> None:
    """Within ``storage_errors`` files are read too, and they may lie beside what is written."""
    target, source = tmp_path / "out", tmp_path / "outside" / "source"
    with pytest.raises(StorageError, match=f"cannot write {target}"), storage_errors(target):
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(tmp_path / written))
    with pytest.raises(StorageError, match=f"cannot write {target}"), storage_errors(target):
        os.rename(tmp_path, target / "a" / "b")
    with pytest.raises(MissingFileError, match=f"does not exist: {source}") as caught, storage_errors(target):
        source.read_bytes()
    assert caught.value.hint


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


def test_what_reads_back_differently_never_gets_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    write_atomic(path, "old")

    class Bent(io.BufferedRandom):
        def write(self, data: Any) -> int:
            return super().write(bytes(data)[:-1] + b"?")

    def bent(name: Path, mode: str, opener: Any) -> Bent:
        return Bent(io.FileIO(name, "w+", opener=opener))

    monkeypatch.setattr(storage, "open", bent, raising=False)
    with pytest.raises(StorageError, match="what was read back is not what was written") as caught:
        write_atomic(path, "new")
    assert caught.value.hint and path.read_text() == "old" and os.listdir(tmp_path) == ["file"]


def test_a_relative_home_is_meant_from_where_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REMA_HOME", "home")
    monkeypatch.setenv("REMA_MANIFESTS", "my/manifests")
    environment.pin()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert rema_home() == tmp_path / "home" and os.environ["REMA_HOME"] == str(tmp_path / "home")
    assert environment.folder_of("REMA_MANIFESTS") == tmp_path / "my" / "manifests"
    monkeypatch.delenv("REMA_HOME")
    assert environment.folder_of("REMA_HOME") is None and rema_home().is_absolute()


@pytest.mark.parametrize("old", [False, True])
def test_a_user_without_a_home_folder(old: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Newer versions of platformdirs raise, older ones leave the tilde in the path."""

    def unknown(*arguments: Any, **options: Any) -> Path:
        if old:
            return Path("~/.cache/rema")
        raise RuntimeError("could not determine the home directory")

    monkeypatch.delenv("REMA_HOME", raising=False)
    monkeypatch.setattr(storage.platformdirs, "user_cache_path", unknown)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    home = tmp_path / f"rema-{os.getuid()}"
    assert rema_home() == home
    write_atomic(rema_home() / "file", "text")
    assert rema_home() == home
    (home / "file").unlink()
    home.rmdir()
    home.symlink_to(tmp_path)
    with pytest.raises(StorageError, match="no home folder") as caught:
        rema_home()
    assert "REMA_HOME" in caught.value.hint


@pytest.mark.parametrize("own", [False, True])
def test_a_user_whose_home_folder_is_the_root(own: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Docker gives one to ``--user NUMBER``: it can be written only where it is the user's own."""
    for variable in ("REMA_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("HOME", "/")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(storage.os, "access", lambda path, mode: own)
    assert rema_home() == (Path("/.cache/rema") if own else tmp_path / f"rema-{os.getuid()}")


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.EROFS, "may be written"), (errno.EACCES, "may be written"), (errno.ENOSPC, "free some")],
)
def test_what_is_below_the_home_can_lie_elsewhere(
    number: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path))
    for path, has in ((tmp_path / "decoded", True), (Path("run") / "x", False)):
        with pytest.raises(StorageError) as caught, storage.storage_errors(path):
            raise OSError(number, os.strerror(number))
        assert ("REMA_HOME" in caught.value.hint) == has and str(path) in caught.value.message
        assert not has or words in caught.value.hint
