"""Out and back: the same release to the last byte, or another one and the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from rema_data.convert import export_release, import_release
from rema_data.errors import InputError, RunMismatchError
from rema_data.loader.release import Release
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.registry import register
from rema_data.store.block import BlockKey, BlockReader
from rema_data.testing import make_release
from rema_data.verify import verify
from tests.rema_data.convert.conftest import files

TASK = "grasp_grasp_push"
TRAIN = f"round-1/{TASK}/train"


@pytest.mark.parametrize("kind", ["exported", "quantised"])
def test_an_unchanged_export_gives_the_same_bytes(
    kind: str, release: ReleaseFolder, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    imported = import_release([request.getfixturevalue(kind)], tmp_path)
    assert imported.identical and imported.differences == () and imported.notes == ()
    assert imported.release.manifest == release.manifest
    assert files(tmp_path) == files(release.root)
    assert all(path.stat().st_mode & 0o222 == 0 for path in tmp_path.rglob("*") if path.is_file())
    assert [path.name for path in tmp_path.iterdir()] == ["tiny"]


def test_files_may_be_named_one_by_one_in_any_order(release: ReleaseFolder, exported: Path, tmp_path: Path) -> None:
    imported = import_release([exported / f"{TASK}.hdf5", exported / "grasp.hdf5"], tmp_path)
    assert imported.identical
    assert imported.release.path == tmp_path / "tiny"


def test_blocks_of_a_parent_lie_where_the_manifest_says(tmp_path: Path) -> None:
    root = tmp_path / "root"
    old = make_release(root, "old", tasks=("push",), episodes=5)
    reused = [BlockKey(1, "push", split) for split in ("train", "val")]
    new = make_release(root, "new", tasks=("push",), rounds=(2,), episodes=5, parent=old.manifest, reused=reused)
    export_release(new, tmp_path / "export")
    imported = import_release([tmp_path / "export"], tmp_path / "back")
    assert imported.identical
    assert len(imported.release.blocks()) == 4
    other = files(tmp_path / "back")
    assert all(data == files(root)[path] for path, data in other.items())
    # Beside the parent, or beside what another import left of it, its blocks are not written again.
    export_release(old, tmp_path / "export-old")
    before = {path: (tmp_path / "back" / path).stat().st_mtime_ns for path in other}
    with pytest.raises(RunMismatchError):
        import_release([tmp_path / "export"], tmp_path / "back")
    assert import_release([tmp_path / "export-old"], tmp_path / "back").identical
    assert {path: (tmp_path / "back" / path).stat().st_mtime_ns for path in other} == before


def test_other_content_in_the_place_of_a_parent_is_not_touched(tmp_path: Path) -> None:
    old = make_release(tmp_path / "root", "old", tasks=("push",), episodes=5)
    reused = [BlockKey(1, "push", split) for split in ("train", "val")]
    new = make_release(tmp_path / "root", "new", (), parent=old.manifest, reused=reused)
    export_release(new, tmp_path / "export")
    other = make_release(tmp_path / "back", "old", tasks=("push",), episodes=5, seed=1)
    before = files(tmp_path / "back")
    with pytest.raises(RunMismatchError, match="other content"):
        import_release([tmp_path / "export"], other.root)
    assert files(tmp_path / "back") == before


def test_another_name_is_another_identity_with_the_same_blocks(
    release: ReleaseFolder, exported: Path, tmp_path: Path
) -> None:
    imported = import_release([exported], tmp_path, "copy")
    assert not imported.identical
    assert imported.differences == ("the name is copy, not tiny",)
    manifest = imported.release.manifest
    assert (manifest.name, manifest.title) == ("copy", release.manifest.title)
    assert release.manifest.sha256 in manifest.description
    blocks = {file.path: file.sha256 for file in manifest.files if file.block}
    assert blocks == {file.path: file.sha256 for file in release.manifest.files if file.block}


def test_a_part_of_a_release_is_a_release(
    release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_release(release, tmp_path / "export", tasks=["grasp"], split="val")
    imported = import_release([tmp_path / "export"], tmp_path / "back")
    assert not imported.identical
    absent = ("round-1/grasp/train", TRAIN, f"round-1/{TASK}/val")
    assert imported.differences == tuple(f"{path}: not part of the export" for path in absent)
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    (tmp_path / "manifests" / "datasets" / "index.json").write_text('{"releases": []}')
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    found = find_release(tmp_path / "back" / "tiny")
    assert found.manifest.counts["episodes"] == 2
    assert files(found.path / "round-1") == {
        path.removeprefix("round-1/"): data
        for path, data in files(release.path).items()
        if path.startswith("round-1/grasp/val")
    }


def changed(export: Path, change: Any) -> Path:
    with h5py.File(export / f"{TASK}.hdf5", "r+") as file:
        change(file)
    return export


def test_episodes_that_were_deleted_are_missing(export: Path, release: ReleaseFolder, tmp_path: Path) -> None:
    def delete(file: h5py.File) -> None:
        for n in (0, 4, 9):
            del file[f"data/demo_{n}"]

    imported = import_release([changed(export, delete)], tmp_path / "back")
    assert imported.differences == (f"{TRAIN}: 7 of 10 episodes",)
    block = imported.release.manifest.select([TASK], split="train")[0]
    reader, original = imported.release.block(block), BlockReader(release.path / TRAIN)
    kept = [row for row in original.steps().to_pylist() if row["episode"] not in (0, 4, 9)]
    found = reader.steps().to_pylist()
    rows = ("scene_row", "ee_row")
    plain = [{name: value for name, value in row.items() if name not in rows} for row in found]
    assert plain == [{name: value for name, value in row.items() if name not in rows} for row in kept]
    for row, before in zip(found, kept, strict=True):
        for name, column in (("scene", "scene_row"), ("ee_depth", "ee_row"), ("ee_mask", "ee_row")):
            one = reader.maps().read(name, row[column], row[column] + 1)
            assert np.array_equal(one, original.maps().read(name, before[column], before[column] + 1))


def test_what_is_left_of_a_block_keeps_its_numbers_and_is_whole(export: Path, tmp_path: Path) -> None:
    def delete(file: h5py.File) -> None:
        for n in (0, 4, 9):
            del file[f"data/demo_{n}"]

    imported = import_release([changed(export, delete)], tmp_path / "back")
    assert imported.release.manifest.plan_sha256 == ""  # or the plan would count as carried out
    assert verify(imported.release).ok
    release = Release(imported.release, cache=tmp_path / "cache")
    assert release.episode(1, TASK, "train", 5).index == 5
    with pytest.raises(InputError, match="no episode 4") as caught:
        release.episode(1, TASK, "train", 4)
    assert "7 of 0 to 8" in caught.value.hint


def test_a_published_name_is_not_given_to_something_else(
    release: ReleaseFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_release(release, tmp_path / "export", tasks=["grasp"])
    (tmp_path / "manifests" / "datasets").mkdir(parents=True)
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    register(release.manifest)
    with pytest.raises(RunMismatchError, match="tiny is a published release, and this is another one") as caught:
        import_release([tmp_path / "export"], tmp_path / "back")
    assert "--name" in caught.value.hint and not (tmp_path / "back").exists()
    assert import_release([tmp_path / "export"], tmp_path / "back", "mine").release.path.name == "mine"


def test_a_block_without_episodes_is_left_out(export: Path, tmp_path: Path) -> None:
    def delete(file: h5py.File) -> None:
        for n in (10, 11):
            del file[f"data/demo_{n}"]

    imported = import_release([changed(export, delete)], tmp_path / "back")
    assert imported.differences == (f"round-1/{TASK}/val: not part of the export",)


def test_an_edited_attribute_is_imported(export: Path, tmp_path: Path) -> None:
    imported = import_release(
        [changed(export, lambda file: file["data/demo_3"].attrs.modify("seed", np.uint64(2**64 - 1)))],
        tmp_path / "back",
    )
    assert imported.differences == (f"{TRAIN}: other content of episodes.parquet",)
    table = BlockReader(imported.release.path / TRAIN).episodes()
    assert table["seed"].to_pylist() == [0, 0, 0, 2**64 - 1, *[0] * 6]


def test_an_edited_map_is_imported(export: Path, release: ReleaseFolder, tmp_path: Path) -> None:
    def raise_a_pixel(file: h5py.File) -> None:
        file["data/demo_0/obs/scene"][0, 5, 6] = 0.12345

    imported = import_release([changed(export, raise_a_pixel)], tmp_path / "back")
    assert imported.differences == (f"{TRAIN}: other content of maps.zarr/scene/c/0/0/0",)
    scene = BlockReader(imported.release.path / TRAIN).maps().read("scene", 0, 1)[0]
    before = BlockReader(release.path / TRAIN).maps().read("scene", 0, 1)[0]
    assert abs(int(scene[5, 6]) - 1334.5) <= 0.5
    scene[5, 6] = before[5, 6]
    assert np.array_equal(scene, before)


def test_what_is_derived_is_not_imported_but_noted(export: Path, tmp_path: Path) -> None:
    def edit(file: h5py.File) -> None:
        for n in range(5):
            file[f"data/demo_{n}/actions"][0, 1] += 0.1
        del file["data/demo_7/rewards"]
        file.create_group("data/demo_90").attrs["num_samples"] = 1
        del file["mask"]

    imported = import_release([changed(export, edit)], tmp_path / "back")
    assert imported.identical
    assert sorted(imported.notes) == [
        f"{TASK}.hdf5, demo_0, demo_1, demo_2 and 2 more: other actions than the columns say, which are imported",
        f"{TASK}.hdf5, demo_7: other rewards than the columns say, which are imported",
        f"{TASK}.hdf5, demo_90: not an episode of the release",
    ]


def test_a_release_is_never_overwritten(release: ReleaseFolder, exported: Path, tmp_path: Path) -> None:
    import_release([exported], tmp_path)
    before = files(tmp_path)
    with pytest.raises(RunMismatchError, match="never written to") as error:
        import_release([exported], tmp_path)
    assert "--name" in error.value.hint
    with pytest.raises(InputError, match="cannot name a release"):
        import_release([exported], tmp_path, "../up")
    assert files(tmp_path) == before
