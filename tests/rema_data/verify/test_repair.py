"""Of a downloaded release the damaged files are fetched again, and only those; other folders are left alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from rema_data import download
from rema_data.errors import InputError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST
from rema_data.verify import verify
from rema_data.verify.repair import remove_damaged, repair
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


def test_card_alone(downloaded: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """A damaged file of the whole release is fetched with any block, and a subset stays one."""
    asked = []
    monkeypatch.setattr(download, "download", lambda name, **options: asked.append((name, options)))
    flip(downloaded.path / "DATASHEET.md", 0)
    repair(downloaded, verify(downloaded))
    assert asked == [("tiny", {"tasks": ["grasp"], "rounds": [1], "split": "train", "manifest": None})]
    assert not (downloaded.path / "DATASHEET.md").exists()


def test_files_that_were_not_downloaded_are_not_deleted(release: ReleaseFolder) -> None:
    path = release.root / location(release, GRASP_TRAIN, SHARD)
    flip(path, 50)
    with pytest.raises(InputError, match="was not downloaded"):
        remove_damaged(release, verify(release))
    assert path.exists()
