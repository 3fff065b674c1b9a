"""Maps that are lost, out of range or stored twice, in a release whose manifest says that its bytes are right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rema_data.heights import MISSING
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockKey
from rema_data.store.maps import ARRAYS, MapsReader, MapsWriter
from rema_data.verify import Finding, verify
from tests.rema_data.verify.damage import location, reseal

PUSH_TRAIN = BlockKey(1, "push", "train")
Maps = dict[str, np.ndarray[Any, Any]]


def with_maps(release: ReleaseFolder, tmp_path: Path, change: Callable[[Maps], None]) -> ReleaseFolder:
    """The release sealed with other maps in a block."""
    reader = MapsReader(release.path / PUSH_TRAIN.path)
    maps = {name: reader.read(name, 0, reader.rows(name)) for name in ARRAYS}
    change(maps)
    writer = MapsWriter(tmp_path / "other")
    for name, rows in maps.items():
        writer.append(name, rows)
    writer.close()
    files = [path for path in (tmp_path / "other").rglob("*") if path.is_file()]
    places = {path.relative_to(tmp_path / "other").as_posix(): path.read_bytes() for path in files}
    return reseal(release, {location(release, PUSH_TRAIN, name): data for name, data in places.items()})


def only(release: ReleaseFolder) -> Finding:
    (finding,) = verify(release, tasks=["push"]).findings
    return finding


def test_a_hole_in_a_map(release: ReleaseFolder, tmp_path: Path) -> None:
    def hole(maps: Maps) -> None:
        maps["scene"][3, 20, 30] = MISSING

    finding = only(with_maps(release, tmp_path, hole))
    assert (finding.kind, finding.where, finding.detail) == ("maps", "row 3", "a height is missing")
    assert finding.file == str(release.path / PUSH_TRAIN.path / "maps.zarr/scene/c/0/0/0")


def test_a_height_out_of_range(release: ReleaseFolder, tmp_path: Path) -> None:
    def tower(maps: Maps) -> None:
        maps["ee_depth"][0, 1, 20, 30] = 40_000

    finding = only(with_maps(release, tmp_path, tower))
    assert (finding.where, finding.detail) == ("row 0", "too high")
    assert finding.file.endswith("maps.zarr/ee_depth/c/0/0/0/0")


def test_a_lost_row(release: ReleaseFolder, tmp_path: Path) -> None:
    def lost(maps: Maps) -> None:
        maps["scene"][4] = MISSING

    finding = only(with_maps(release, tmp_path, lost))
    assert finding.kind == "maps" and "row 4 is missing" in finding.detail


def test_a_lost_shard_that_the_manifest_does_not_name(release: ReleaseFolder) -> None:
    finding = only(reseal(release, {location(release, PUSH_TRAIN, "maps.zarr/scene/c/0/0/0"): None}))
    assert finding.kind == "maps" and "row 0 is missing" in finding.detail
    assert finding.file.endswith("push/train/maps.zarr/scene/c/0/0/0")


def test_an_end_effector_map_twice(release: ReleaseFolder, tmp_path: Path) -> None:
    def twice(maps: Maps) -> None:
        for name in ("ee_depth", "ee_mask"):
            maps[name] = np.concatenate([maps[name], maps[name]])

    details = {finding.detail for finding in verify(with_maps(release, tmp_path, twice), tasks=["push"]).findings}
    assert "the same end-effector map as row 0" in details
    assert "no step uses the map" in details
    assert "it has 2 rows, the manifest says 1" in details


@pytest.mark.parametrize("name", ["maps.zarr/zarr.json", "maps.zarr/ee_mask/zarr.json"])
def test_sealed_metadata_that_are_none(release: ReleaseFolder, name: str) -> None:
    finding = only(reseal(release, {location(release, PUSH_TRAIN, name): b"{}"}))
    assert finding.kind == "maps"


def test_undamaged_arrays_are_read_beside_a_damaged_one(release: ReleaseFolder, tmp_path: Path) -> None:
    def hole(maps: Maps) -> None:
        maps["scene"][3, 20, 30] = MISSING

    damaged = with_maps(release, tmp_path, hole)
    (damaged.path / PUSH_TRAIN.path / "maps.zarr/ee_mask/c/0/0/0/0").unlink()
    report = verify(damaged, tasks=["push"])
    assert sorted(report.counts) == ["maps", "missing"]
    assert report.unread == [PUSH_TRAIN.path]
