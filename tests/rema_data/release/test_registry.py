"""The index of published releases: in order, checked, and never rewritten."""

from __future__ import annotations

import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.registry import SAMPLE, load_published, newest, preferred, published, register
from rema_data.repair import restore


def test_what_is_registered_is_found(places: Path, tiny: ReleaseFolder) -> None:
    path = register(tiny.manifest)
    assert path.read_bytes() == tiny.manifest.to_bytes()
    assert published() == {"tiny": tiny.manifest.sha256}
    assert load_published("tiny") == tiny.manifest


def test_registering_again_changes_nothing(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    index = (places / "manifests" / "datasets" / "index.json").read_bytes()
    register(tiny.manifest)
    assert (places / "manifests" / "datasets" / "index.json").read_bytes() == index


def test_no_entry_is_lost_between_several_that_register(places: Path, tiny: ReleaseFolder) -> None:
    others = [dataclasses.replace(tiny.manifest, name=f"tiny-{n}") for n in range(12)]
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(register, others))
    assert published() == {one.name: one.sha256 for one in others}


def test_other_content_under_a_published_name_is_refused(places: Path, tiny: ReleaseFolder) -> None:
    path = register(tiny.manifest)
    with pytest.raises(InputError, match="published with other content") as caught:
        register(dataclasses.replace(tiny.manifest, title="another"))
    assert "new name" in caught.value.hint
    assert path.read_bytes() == tiny.manifest.to_bytes()
    assert load_published("tiny") == tiny.manifest


def renamed(release: ReleaseFolder, name: str) -> ReleaseFolder:
    """The same release under another name, as far as a manifest can tell."""
    manifest = release.manifest
    files = tuple(dataclasses.replace(file, holder=name) for file in manifest.files)
    blocks = tuple(dataclasses.replace(block, holder=name) for block in manifest.blocks)
    return ReleaseFolder(dataclasses.replace(manifest, name=name, files=files, blocks=blocks), release.root)


def test_the_newest_is_the_last_but_the_sample(places: Path, tiny: ReleaseFolder) -> None:
    with pytest.raises(MissingFileError, match="no release has been published"):
        newest()
    for name in ("b-first", "a-second", SAMPLE):
        register(renamed(tiny, name).manifest)
    assert list(published()) == ["b-first", "a-second", SAMPLE]
    assert newest() == "a-second"


def test_what_continues_a_release_is_taken_by_its_name(places: Path, tiny: ReleaseFolder) -> None:
    """The newest is one that a user of the paper's tasks expects; a further task or other scenes are asked for."""
    for name, continues in (("first", None), ("second", None), ("second-more", "second"), (SAMPLE, None)):
        register(renamed(tiny, name).manifest, continues)
    register(renamed(tiny, "second-more").manifest)  # once more, by `rema collect --register`: nothing changes
    assert preferred() == ["second", "first", "second-more", SAMPLE] and newest() == "second"
    rows = json.loads((places / "manifests" / "datasets" / "index.json").read_bytes())["releases"]
    assert [row.get("continues") for row in rows] == [None, None, "second", None]


def test_an_unknown_name_lists_the_known_ones(places: Path, tiny: ReleaseFolder) -> None:
    register(tiny.manifest)
    with pytest.raises(InputError, match="no release 'huge'") as caught:
        load_published("huge")
    assert "tiny" in caught.value.hint


def test_a_changed_or_deleted_manifest_is_not_the_published_one(places: Path, tiny: ReleaseFolder) -> None:
    path = register(tiny.manifest)
    path.write_bytes(path.read_bytes().replace(b"tests only", b"tests 0nly"))
    with pytest.raises(IntegrityError, match="expected") as caught:
        load_published("tiny")
    assert caught.value.hint == f"copy {path} again from where it came from"
    path.unlink()
    with pytest.raises(MissingFileError, match=r"tiny\.json does not exist"):
        load_published("tiny")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"<html>",
        b"[]",
        b'{"releases": [{}]}',
        b'{"releases": [1]}',
        b'{"releases": null}',
        b'{"releases": [{"name": "../x", "sha256": "0"}]}',
        b'{"releases": [{"name": 3, "sha256": "0"}]}',
    ],
)
def test_a_damaged_index_is_named(data: bytes, places: Path) -> None:
    index = places / "manifests" / "datasets" / "index.json"
    index.write_bytes(data)
    with pytest.raises(IntegrityError, match=r"index\.json cannot be read") as caught:
        published()
    assert caught.value.hint == restore(index)


def test_a_missing_index_is_named(places: Path) -> None:
    (places / "manifests" / "datasets" / "index.json").unlink()
    with pytest.raises(MissingFileError, match=r"the index of releases .* does not exist"):
        published()
