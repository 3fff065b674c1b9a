"""The command that brings a file back works for the folder in question: one rule for all places."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.release.folder import ReleaseFolder, downloads_folder
from rema_data.release.manifest import MANIFEST
from rema_data.release.registry import register
from rema_data.release.repair import RepairHints, manifest_repair
from rema_data.store.block import BlockReader

FILE = "tiny/round-1/grasp/train/steps.parquet"
AGAIN = "copy it again from where the release came from, or collect the release again: rema collect PLAN"


def copied(release: ReleaseFolder, root: Path) -> ReleaseFolder:
    shutil.copytree(release.path, root / "tiny")
    return ReleaseFolder(release.manifest, root)


def test_a_release_that_is_not_published(places: Path, tiny: ReleaseFolder) -> None:
    mending = RepairHints(copied(tiny, places / "my data"))
    assert mending.verify == f"rema verify '{places}/my data/tiny'"
    assert mending.file(FILE) == AGAIN
    assert mending.blocks([tiny.manifest.blocks[0].key]) == AGAIN.replace("it", "them", 1)


def test_a_download(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    release = copied(tiny, downloads_folder())
    assert RepairHints(release).file(FILE) == "rema verify tiny --repair --source URL"
    copied(tiny, places / "releases")  # which a download asks
    assert RepairHints(release).file(FILE) == "rema verify tiny --repair"
    assert RepairHints(release).blocks([tiny.manifest.blocks[0].key]) == "fetch them: rema download tiny --task grasp"


def test_the_name_is_used_where_it_leads_to_the_folder(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    damaged = copied(tiny, downloads_folder())
    assert RepairHints(damaged).address == "tiny"
    damaged.root.joinpath(FILE).unlink()
    copied(tiny, places / "releases")  # now opened by the name, for it has more blocks
    assert RepairHints(damaged).address == str(damaged.path)


def test_a_download_of_a_release_that_is_not_published(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, downloads_folder())
    assert RepairHints(release).file(FILE) == f"rema verify {release.path} --repair --source URL"
    command = RepairHints(release).blocks([tiny.manifest.blocks[0].key])
    assert command.endswith(f"rema download tiny --task grasp --manifest {release.path / MANIFEST} --source URL")


def test_a_copy_of_a_published_release(places: Path, tiny: ReleaseFolder) -> None:
    """What a download brings does not arrive in this folder: the user is told to open that."""
    register(tiny.manifest)
    mending = RepairHints(copied(tiny, places / "elsewhere"))
    assert mending.verify == f"rema verify {places}/elsewhere/tiny"
    instead = "fetch the published files, and open them by their name: rema download tiny"
    assert mending.file(FILE) == f"{instead} --source URL"
    assert mending.blocks([tiny.manifest.blocks[0].key]) == f"{instead} --task grasp --source URL"


def test_a_checkout(places: Path, tiny: ReleaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    register(tiny.manifest)
    (places / ".git").mkdir()
    mending = RepairHints(copied(tiny, places / "data"))
    assert mending.file(FILE) == f"git checkout -- data/{FILE}"
    block = tiny.manifest.blocks[0].key
    assert mending.blocks([block]) == f"bring them back: git checkout -- data/tiny/{block.path}"
    assert manifest_repair(places / "data" / "tiny" / MANIFEST) == f"git checkout -- data/tiny/{MANIFEST}"
    monkeypatch.chdir(places / "data")  # where git would look for data/data
    assert mending.file(FILE) == f"git -C {places} checkout -- data/{FILE}"


def test_a_package(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, places / "_releases")
    assert RepairHints(release).file(FILE) == "pip install --force-reinstall rema"


def test_the_manifest_of_a_download(places: Path, tiny: ReleaseFolder) -> None:
    path = downloads_folder() / "tiny" / MANIFEST
    assert manifest_repair(path) == f"copy {path} again from where the release came from"
    register(tiny.manifest)
    assert manifest_repair(path) == f"rm {path}, and go on with its download: rema download tiny"


def test_readers_of_a_block_say_the_same(places: Path, tiny: ReleaseFolder) -> None:
    release = copied(tiny, places / "data")
    reader = release.block(tiny.manifest.blocks[0])
    assert reader.repair_hint(release.root / FILE) == f"to fix it: {AGAIN}\nfind all damage: rema verify {release.path}"
    assert "rema verify" in BlockReader(reader.folder).repair_hint(reader.folder)
