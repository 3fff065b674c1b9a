"""Sealing: a release is whole or it is not there, and nothing writes to it afterwards."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from rema_data.errors import InputError, IntegrityError, RunMismatchError, StorageError
from rema_data.release import seal as sealing
from rema_data.release.manifest import MANIFEST, parse_manifest
from rema_data.release.seal import Description, describe_block, seal
from rema_data.store.block import BlockKey
from rema_data.testing import FINGERPRINT, make_block, make_release

ABOUT = Description("fresh", "A release", "Synthetic.", "CC-BY-4.0", "The rema authors", ("https://example.org",))
TRAIN, VAL = BlockKey(1, "push", "train"), BlockKey(1, "push", "val")


def staged(root: Path, *keys: BlockKey) -> Path:
    staging = root / ".staging"
    for key in keys:
        make_block(staging / key.path, key, 6)
    return staging


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_sealed_release_is_what_its_manifest_says(tmp_path: Path) -> None:
    about = dataclasses.replace(ABOUT, published="2026-01-31")
    release = seal(staged(tmp_path, VAL, TRAIN), tmp_path, about, [VAL, TRAIN], fingerprint=FINGERPRINT)
    manifest = parse_manifest((release.path / MANIFEST).read_bytes(), "here", release.manifest.sha256)
    assert manifest == release.manifest
    assert (manifest.name, manifest.sources, manifest.published) == ("fresh", ABOUT.sources, "2026-01-31")
    assert dict(manifest.fingerprint) == FINGERPRINT
    assert [block.key for block in manifest.blocks] == [TRAIN, VAL]
    assert release.blocks() == manifest.blocks
    found = contents(release.path)
    del found[MANIFEST]
    assert sorted(found) == sorted(file.path for file in manifest.files)
    for file in manifest.files:
        assert (file.bytes, file.sha256) == (len(found[file.path]), hashlib.sha256(found[file.path]).hexdigest())
    assert not (tmp_path / ".staging").exists()


def test_an_entry_counts_what_the_block_holds(tmp_path: Path) -> None:
    key = BlockKey(2, "grasp_push", "train")
    make_block(tmp_path, key, 12)
    entry = describe_block(tmp_path, key, "holder")
    assert (entry.key, entry.holder) == (key, "holder")
    assert (entry.episodes, entry.policies) == (12, ("reference", "random"))
    assert 0 < entry.positives < 12
    assert entry.steps > 12
    assert entry.end_effectors == 1 + entry.steps - 12


def test_equal_data_are_an_equal_release(tmp_path: Path) -> None:
    first, second = (make_release(tmp_path / name, tasks=("push",), episodes=6) for name in "ab")
    assert first.manifest.sha256 == second.manifest.sha256
    assert contents(first.path) == contents(second.path)
    other = make_release(tmp_path / "c", tasks=("push",), episodes=6, seed=1)
    assert other.manifest.sha256 != first.manifest.sha256


def test_files_are_read_only(tmp_path: Path) -> None:
    release = seal(staged(tmp_path, TRAIN), tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    for path in release.path.rglob("*"):
        if path.is_file():
            assert not stat.S_IMODE(path.stat().st_mode) & 0o222, path


def test_a_release_is_never_written_to(tmp_path: Path) -> None:
    release = seal(staged(tmp_path, TRAIN), tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    before = contents(release.path)
    staging = staged(tmp_path, VAL)
    with pytest.raises(RunMismatchError, match="never written to"):
        seal(staging, tmp_path, ABOUT, [VAL], fingerprint=FINGERPRINT)
    assert contents(release.path) == before
    assert staging.is_dir()


@pytest.mark.parametrize("name", ["../out", "", "Big", "a/b", ".."])
def test_a_name_that_climbs_is_refused(name: str, tmp_path: Path) -> None:
    about = dataclasses.replace(ABOUT, name=name)
    with pytest.raises(InputError, match="cannot name a release"):
        seal(tmp_path / ".staging", tmp_path, about, [], fingerprint=FINGERPRINT)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("stop", ["write_card", "write_atomic", "_settle", "rename"])
def test_a_sealing_that_was_stopped_leaves_no_release(
    stop: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    staging = staged(tmp_path, TRAIN)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os if stop == "rename" else sealing, stop, killed)
        with pytest.raises(KeyboardInterrupt):
            seal(staging, tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    assert not (tmp_path / "fresh").exists()
    again = seal(staging, tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    whole = seal(staged(tmp_path / "b", TRAIN), tmp_path / "b", ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    assert contents(again.path) == contents(whole.path)


def test_a_full_disk_is_a_storage_error(tmp_path: Path) -> None:
    code = f"""
import resource
from pathlib import Path
from rema_data.errors import StorageError
from rema_data.release.seal import seal
from tests.rema_data.release.test_seal import ABOUT, FINGERPRINT, TRAIN, staged
root = Path({str(tmp_path)!r})
staging = staged(root, TRAIN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    seal(staging, root, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
except StorageError as error:
    print(error.message)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert "larger than is allowed" in done.stdout
    assert not (tmp_path / "fresh").exists()


def test_blocks_of_a_parent_stay_where_they_are(tmp_path: Path) -> None:
    parent = seal(staged(tmp_path, TRAIN, VAL), tmp_path, ABOUT, [TRAIN, VAL], fingerprint=FINGERPRINT)
    new = BlockKey(2, "push", "train")
    about = dataclasses.replace(ABOUT, name="next")
    child = seal(staged(tmp_path, new), tmp_path, about, [new], fingerprint={}, parent=parent.manifest, reused=[TRAIN])
    manifest = child.manifest
    assert manifest.parent is not None
    assert (manifest.parent.name, manifest.parent.sha256) == ("fresh", parent.manifest.sha256)
    assert [(block.key, block.holder) for block in manifest.blocks] == [(TRAIN, "fresh"), (new, "next")]
    shared = [file for file in manifest.files if file.holder == "fresh"]
    assert shared == [file for file in parent.manifest.files if file.block == TRAIN.path]
    assert not (child.path / "round-1").exists()
    assert child.blocks() == manifest.blocks


def test_a_block_cannot_be_both_new_and_reused(tmp_path: Path) -> None:
    parent = seal(staged(tmp_path, TRAIN), tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    about = dataclasses.replace(ABOUT, name="next")
    for keys, reused in (([TRAIN], [TRAIN]), ([VAL, VAL], []), ([], [VAL])):
        with pytest.raises(InputError, match="listed twice, or is not in the parent"):
            seal(tmp_path / "x", tmp_path, about, keys, fingerprint={}, parent=parent.manifest, reused=reused)


def test_damaged_tables_are_not_sealed(tmp_path: Path) -> None:
    staging = staged(tmp_path, TRAIN)
    path = staging / TRAIN.path / "steps.parquet"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(IntegrityError, match=r"steps\.parquet is damaged"):
        seal(staging, tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    assert not (tmp_path / "fresh").exists()


def test_a_folder_that_may_not_be_written_is_a_storage_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    staging = staged(tmp_path, TRAIN)

    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "rename", refused)
    with pytest.raises(StorageError, match="may not be written"):
        seal(staging, tmp_path, ABOUT, [TRAIN], fingerprint=FINGERPRINT)
    assert not (tmp_path / "fresh").exists()
