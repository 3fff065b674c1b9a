"""Finding releases: by name, by path, in parts, and beside their parents."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.release import folder as folders
from rema_data.release.folder import ReleaseFolder, downloads_folder, find_release
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import register
from rema_data.store.block import BlockKey
from rema_data.testing import make_release


@pytest.fixture
def nothing_bundled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the home and the working folder have releases."""
    monkeypatch.setattr(folders, "local_sources", lambda: (Path.cwd() / "releases",))


def copied(release: ReleaseFolder, root: Path) -> ReleaseFolder:
    shutil.copytree(release.path, root / release.manifest.name)
    return ReleaseFolder(release.manifest, root)


def test_by_path(places: Path, tiny: ReleaseFolder) -> None:
    for path in (tiny.path, str(tiny.path), f"{tiny.path}/"):
        found = find_release(path)
        assert (found.manifest, found.root) == (tiny.manifest, tiny.root.resolve())
        assert found.blocks() == tiny.manifest.blocks


def test_by_a_relative_path(places: Path, tiny: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tiny.path)
    assert find_release(".").root == tiny.root.resolve()


def test_by_name_in_the_home_and_in_a_checkout(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    with pytest.raises(MissingFileError, match="not on this machine") as caught:
        find_release("tiny")
    assert "rema download tiny" in caught.value.hint
    copied(tiny, places / "releases")
    assert find_release("tiny").root == places / "releases"
    home = copied(tiny, downloads_folder())
    assert find_release("tiny").root == home.root == places / "home" / "releases"


def test_the_place_with_most_blocks_is_chosen(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    copied(tiny, places / "releases")
    part = copied(tiny, downloads_folder())
    shutil.rmtree(part.path / "round-1" / "grasp")
    assert find_release("tiny").root == places / "releases"


def test_by_default_the_newest_that_is_here(places: Path, tiny: ReleaseFolder, nothing_bundled: None) -> None:
    register(tiny.manifest)
    register(make_release(places / "elsewhere", "newer", tasks=("push",), episodes=5).manifest)
    with pytest.raises(MissingFileError, match="no release is on this machine") as caught:
        find_release()
    assert "rema download" in caught.value.hint
    copied(tiny, downloads_folder())
    assert find_release().manifest.name == "tiny"
    shutil.copytree(places / "elsewhere" / "newer", downloads_folder() / "newer")
    assert find_release().manifest.name == "newer"


def test_a_name_that_is_nothing(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    with pytest.raises(InputError, match="neither a published release nor a folder") as caught:
        find_release("tinny")
    assert "tiny" in caught.value.hint


def test_a_folder_that_is_no_release(places: Path) -> None:
    with pytest.raises(MissingFileError, match=f"has no {MANIFEST}"):
        find_release(places)


def test_a_folder_under_another_name(places: Path, tiny: ReleaseFolder) -> None:
    shutil.copytree(tiny.path, places / "other")
    found = find_release(places / "other")
    assert (found.path, found.manifest) == (places / "other", tiny.manifest)
    assert found.blocks() == tiny.blocks()
    victim = found.file(next(file for file in found.manifest.files if file.block is not None))
    victim.chmod(0o644)
    victim.write_bytes(b"")
    assert victim.is_relative_to(places / "other") and len(found.blocks()) == len(tiny.blocks()) - 1
    assert "copy it again" in found.repair.at(victim) and f"rema verify {places / 'other'}" in found.repair.at(victim)


def test_a_copy_under_another_name_finds_the_blocks_of_its_parent(places: Path, tiny: ReleaseFolder) -> None:
    parent = copied(tiny, places)
    key = BlockKey(1, "grasp_push", "train")
    child = make_release(places, "child", tasks=("push",), episodes=5, parent=parent.manifest, reused=(key,))
    child.path.rename(places / "renamed")
    found = find_release(places / "renamed")
    assert key in {block.key for block in found.blocks()} and len(found.blocks()) == len(child.manifest.blocks)


def test_a_damaged_manifest_beside_the_data(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, places)
    path = release.path / MANIFEST
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(IntegrityError, match="cannot be used") as caught:
        find_release(release.path)
    assert caught.value.hint == f"copy {path} again from where it came from"


def test_blocks_are_here_when_all_their_files_have_their_size(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    release = copied(tiny, downloads_folder())
    victim = release.path / "round-1" / "grasp" / "val" / "steps.parquet"
    victim.chmod(0o644)
    victim.write_bytes(victim.read_bytes()[:-1])
    (release.path / "round-1" / "grasp_push" / "train" / "maps.zarr" / "scene" / "c" / "0" / "0" / "0").unlink()
    assert [block.key.path for block in release.blocks()] == ["round-1/grasp/train", "round-1/grasp_push/val"]
    release.require(release.manifest.select("grasp", split="train"))
    with pytest.raises(MissingFileError, match="2 blocks of tiny are missing or not whole on this machine") as caught:
        release.require(release.manifest.blocks)
    assert caught.value.hint == "fetch them: rema download tiny --task grasp --task grasp_push --source URL"


def test_blocks_of_a_parent_lie_beside_the_release(places: Path, tiny: ReleaseFolder) -> None:
    parent = copied(tiny, places)
    key = BlockKey(1, "grasp_push", "train")
    child = make_release(places, "child", tasks=("push",), episodes=5, parent=parent.manifest, reused=(key,))
    found = find_release(child.path)
    entry = next(block for block in found.manifest.blocks if block.key == key)
    assert found.block(entry).folder == parent.path.resolve() / key.path
    assert found.block(entry).steps().num_rows == entry.steps
    shutil.rmtree(parent.path)
    assert key not in {block.key for block in find_release(child.path).blocks()}
