"""The command that brings a file back works for the folder in question: one rule for all places."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.errors import IntegrityError
from rema_data.release.folder import ReleaseFolder, downloads_folder, find_release
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import register
from rema_data.repair import reinstall
from rema_data.store.block import BlockReader

FILE = "tiny/round-1/grasp/train/steps.parquet"
AGAIN = "copy it again from where the release came from, or collect the release again: rema collect PLAN"


def copied(release: ReleaseFolder, root: Path) -> ReleaseFolder:
    shutil.copytree(release.path, root / "tiny")
    return ReleaseFolder(release.manifest, root)


def hint_of_a_broken_manifest(folder: Path) -> str:
    (folder / MANIFEST).chmod(0o644)
    (folder / MANIFEST).write_text("{")
    with pytest.raises(IntegrityError) as caught:
        find_release(folder)
    return caught.value.hint


def test_a_release_that_is_not_published(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, places / "my data")
    repair = release.repair
    assert repair.verify == f"rema verify '{places}/my data/tiny'"
    assert repair.file(FILE) == AGAIN
    assert release.missing_hint([tiny.manifest.blocks[0]]) == AGAIN.replace("it", "them", 1)


def test_a_download(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    release = copied(tiny, downloads_folder())
    assert release.repair.file(FILE) == "rema verify tiny --repair --source URL"
    copied(tiny, places / "releases")  # which a download asks
    assert release.repair.file(FILE) == "rema verify tiny --repair"
    assert release.missing_hint([tiny.manifest.blocks[0]]) == "fetch them: rema download tiny --task grasp"


def test_the_name_is_used_where_it_leads_to_the_folder(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    damaged = copied(tiny, downloads_folder())
    assert damaged.repair.address == "tiny"
    damaged.root.joinpath(FILE).unlink()
    copied(tiny, places / "releases")  # now opened by the name, for it has more blocks
    assert damaged.repair.address == str(damaged.path)


def test_a_download_of_a_release_that_is_not_published(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, downloads_folder())
    assert release.repair.file(FILE) == f"rema verify {release.path} --repair --source URL"
    command = release.missing_hint([tiny.manifest.blocks[0]])
    assert command.endswith(f"rema download tiny --task grasp --manifest {release.path / MANIFEST} --source URL")


def test_a_copy_of_a_published_release(places: Path, tiny: ReleaseFolder) -> None:
    """What a download brings does not arrive in this folder: the user is told to open that."""
    register(tiny.manifest)
    release = copied(tiny, places / "elsewhere")
    repair = release.repair
    assert repair.verify == f"rema verify {places}/elsewhere/tiny"
    instead = "fetch the published files, and open them by their name: rema download tiny"
    assert repair.file(FILE) == f"{instead} --source URL"
    assert release.missing_hint([tiny.manifest.blocks[0]]) == f"{instead} --task grasp --source URL"


def test_a_checkout(places: Path, tiny: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    register(tiny.manifest)
    (places / ".git").mkdir()
    release = copied(tiny, places / "data")
    repair = release.repair
    assert repair.file(FILE) == f"git checkout -- data/{FILE}"
    block = tiny.manifest.blocks[0]
    assert release.missing_hint([block]) == f"bring them back: git checkout -- data/tiny/{block.key.path}"
    assert hint_of_a_broken_manifest(places / "data" / "tiny") == f"git checkout -- data/tiny/{MANIFEST}"
    monkeypatch.chdir(places / "data")  # where git would look for data/data
    assert repair.file(FILE) == f"git -C {places} checkout -- data/{FILE}"


def test_a_package(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, places / "_releases")
    assert release.repair.file(FILE) == reinstall()


def test_the_manifest_of_a_download(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, downloads_folder())
    path = release.path / MANIFEST
    assert hint_of_a_broken_manifest(release.path) == f"copy {path} again from where it came from"
    register(tiny.manifest)
    assert hint_of_a_broken_manifest(release.path) == f"rm {path}, and resume the download: rema download tiny"


def test_readers_of_a_block_say_the_same(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, places / "data")
    reader = release.block(tiny.manifest.blocks[0])
    assert reader.repair_hint(release.root / FILE) == f"to fix it: {AGAIN}\nfind all damage: rema verify {release.path}"
    assert "rema verify" in BlockReader(reader.folder).repair_hint(reader.folder)
