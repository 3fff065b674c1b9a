"""Of a downloaded release the damaged files are fetched again, and only those; other folders are left alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.errors import InputError, MissingFileError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST
from rema_data.verify import verify
from rema_data.verify.files import repair
from tests.rema_data.verify.damage import GRASP_TRAIN, copy, flip, location

SHARD = "maps.zarr/scene/c/0/0/0"


def files(release: ReleaseFolder) -> dict[str, tuple[int, int]]:
    """Inode and time of change of every file."""
    stats = {path: path.stat() for path in release.path.rglob("*") if path.is_file()}
    return {str(path): (stat.st_ino, stat.st_mtime_ns) for path, stat in stats.items()}


def test_repair_fetches_what_is_damaged(
    downloaded: ReleaseFolder, small: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "releases").mkdir()
    copy(small, tmp_path / "releases")  # a source, found in the current folder
    monkeypatch.chdir(tmp_path)
    before = files(downloaded)
    damaged = [location(downloaded, GRASP_TRAIN, SHARD), location(downloaded, GRASP_TRAIN, "steps.parquet")]
    flip(downloaded.root / damaged[0], 50)
    (downloaded.root / damaged[1]).unlink()
    report = verify(downloaded)
    assert sorted(report.damaged) == damaged
    repair(downloaded, report)
    assert verify(downloaded).ok
    after = files(downloaded)
    changed = {path for path in before if before[path] != after[path]}
    assert changed - {str(downloaded.path / MANIFEST)} == {str(downloaded.root / place) for place in damaged}


def test_card_alone(downloaded: ReleaseFolder, small: ReleaseFolder, tmp_path: Path) -> None:
    """A damaged file of the whole release is fetched alone, from the source that is named, and a subset stays one."""
    shutil.rmtree(downloaded.path / "round-1/push")
    mirror = copy(small, tmp_path / "mirror").root
    flip(downloaded.path / "DATASHEET.md", 0)
    repair(downloaded, verify(downloaded), [mirror])
    report = verify(downloaded)
    assert report.ok and report.absent == ["round-1/push/train", "round-1/push/val"]


def test_a_damaged_manifest_is_written_again(downloaded: ReleaseFolder) -> None:
    path = downloaded.path / MANIFEST
    path.write_bytes(b"{}")
    repair(downloaded, verify(downloaded))
    assert path.read_bytes() == downloaded.manifest.to_bytes() and verify(downloaded).ok


def test_a_damaged_file_stays_until_its_replacement_is_here(
    downloaded: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = downloaded.root / location(downloaded, GRASP_TRAIN, SHARD)
    flip(path, 50)
    damaged = path.read_bytes()
    with pytest.raises(MissingFileError) as caught:
        repair(downloaded, verify(downloaded))
    assert caught.value.hint == "name a mirror: rema verify tiny --repair --source URL"
    assert path.read_bytes() == damaged
    assert not list(downloaded.root.rglob("*.part"))


def test_the_folder_itself_is_no_source(
    downloaded: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path / "home")
    flip(downloaded.path / "DATASHEET.md", 0)
    with pytest.raises(MissingFileError, match="tiny/DATASHEET.md") as caught:
        repair(downloaded, verify(downloaded))
    assert "other bytes" not in caught.value.message


def test_files_that_were_not_downloaded_are_not_changed(release: ReleaseFolder) -> None:
    path = release.root / location(release, GRASP_TRAIN, SHARD)
    flip(path, 50)
    damaged = path.read_bytes()
    with pytest.raises(InputError, match="was not downloaded"):
        repair(release, verify(release))
    assert path.read_bytes() == damaged
