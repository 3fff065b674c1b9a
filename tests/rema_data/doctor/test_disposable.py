"""Caches and partial downloads: what they are good for, and how they are cleared away."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from filelock import FileLock

from rema_data.doctor.disposable import Disposable, disposables, prune
from rema_data.doctor.releases import local_releases
from rema_data.loader.release import Release
from rema_data.release.folder import find_release


@pytest.fixture
def cache(machine: Path) -> Path:
    """The decoded cache of the release."""
    folder = Release(find_release("tiny")).cache.folder
    assert folder is not None and folder.parent == machine / "home" / "decoded"
    return folder


def states() -> dict[str, str]:
    return {Path(item.path).name: item.state for item in disposables(local_releases())}


def test_ready(machine: Path, cache: Path) -> None:
    (found,) = disposables(local_releases())
    assert (found.path, found.release, found.state) == (str(cache), "tiny", "ready")
    assert found.bytes == sum(path.stat().st_size for path in cache.iterdir())
    assert prune([found]) == () and cache.is_dir()


def test_old_when_the_blocks_have_changed(machine: Path, cache: Path) -> None:
    shutil.rmtree(machine / "home" / "releases" / "tiny" / "round-1" / "push")
    assert states() == {cache.name: "old"}


def test_orphan_when_the_release_is_gone(machine: Path, cache: Path) -> None:
    shutil.rmtree(machine / "home" / "releases" / "tiny")
    assert states() == {cache.name: "orphan"}


def test_damaged(machine: Path, cache: Path) -> None:
    with (cache / "scene.npy").open("ab") as file:
        file.write(b"x")
    assert states() == {cache.name: "damaged"}


def test_damaged_content(machine: Path, cache: Path) -> None:
    with (cache / "ee_mask.npy").open("rb+") as file:
        file.seek(200)
        file.write(b"damage")
    assert states() == {cache.name: "ready"}
    (found,) = disposables(local_releases(), contents=True)
    assert (found.state, found.damaged) == ("damaged", ("ee_mask.npy",))
    assert prune([found]) == (found,) and not cache.exists()


def test_unfinished_and_partial(machine: Path, cache: Path) -> None:
    (cache.parent / f".{cache.name}.abc").mkdir()
    part = machine / "home" / "releases" / "tiny" / "round-1" / "steps.parquet.part"
    part.write_bytes(b"12345")
    found = {Path(item.path): item for item in disposables(local_releases())}
    assert {path.name: item.state for path, item in found.items()} == {
        cache.name: "ready",
        f".{cache.name}.abc": "unfinished",
        part.name: "partial",
    }
    assert (found[part].release, found[part].bytes) == ("tiny", 5)
    deleted = prune(found.values())
    assert {item.state for item in deleted} == {"unfinished", "partial"}
    assert states() == {cache.name: "ready"}


def test_nothing_is_taken_from_a_process_that_works_on_it(machine: Path, cache: Path) -> None:
    """Neither from a builder of the cache nor from a download: both hold a lock."""
    (cache / "cache.json").unlink()
    part = machine / "home" / "releases" / "tiny" / "steps.parquet.part"
    part.touch()
    found = disposables(local_releases())
    locks = (cache.parent / f"{cache.name}.lock", machine / "home" / "releases" / ".tiny.lock")
    assert {item.lock for item in found} == {str(path) for path in locks}
    with FileLock(locks[0]), FileLock(locks[1]):
        assert prune(found) == ()
        assert cache.is_dir() and part.exists()
    assert len(prune(found)) == 2
    assert not cache.exists() and not part.exists()


def test_prune_is_not_confused_by_what_is_gone_already(machine: Path, cache: Path) -> None:
    (cache / "cache.json").unlink()
    (found,) = disposables(local_releases())
    assert prune([found]) == (found,)
    part = Disposable(str(machine / "home" / "x.part"), "x", "partial", 0, str(machine / "home" / ".x.lock"))
    assert prune([part]) == (part,)
