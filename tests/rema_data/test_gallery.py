"""Choosing steps of a release to look at."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.gallery import GalleryStep, find_steps
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockKey
from rema_data.testing import make_release, synthetic_episode


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("tiny"), tasks=("grasp", "grasp_push"), episodes=15)


def places(steps: list[GalleryStep]) -> list[tuple[str, str, int, int]]:
    return [(step.row["task"], step.row["split"], step.row["episode"], step.row["step"]) for step in steps]


def test_an_episode_is_shown_whole_and_as_it_was(tiny: ReleaseFolder) -> None:
    steps = find_steps(tiny, ["grasp_push"], split="train", episodes=[3, 7])
    episodes = [synthetic_episode(BlockKey(1, "grasp_push", "train"), index) for index in (3, 7)]
    expected = [step for episode in episodes for step in episode.steps]
    assert places(steps) == [("grasp_push", "train", e.index, s.situation.step) for e in episodes for s in e.steps]
    for shown, step in zip(steps, expected, strict=True):
        assert shown.row["action"] == step.action.index
        for name in ("scene", "depth", "mask"):
            assert np.array_equal(getattr(shown.observation, name), getattr(step.observation, name))


def test_a_selection_is_always_the_same_and_in_order(tiny: ReleaseFolder) -> None:
    steps = find_steps(tiny, count=8)
    assert len(steps) == 8
    assert places(find_steps(tiny, count=8)) == places(steps)
    everything = places(find_steps(tiny, count=10_000))
    assert [place for place in everything if place in places(steps)] == places(steps)
    assert places(steps) != everything[:8]


def test_only_what_is_asked_for(tiny: ReleaseFolder) -> None:
    rows = [step.row for step in find_steps(tiny, which="all", count=1000)]
    assert len(rows) == tiny.manifest.counts["steps"]
    for which, last in (("last", True), ("picks", False)):
        assert {step.row["last"] for step in find_steps(tiny, which=which, count=1000)} == {last}  # type: ignore[arg-type]
    won = find_steps(tiny, success=True, count=1000)
    assert len(won) == sum(row["success"] and row["last"] for row in rows)
    missed = find_steps(tiny, which="all", failure="missed", count=1000)
    assert len(missed) == sum(row["failure"] == "missed" for row in rows)
    assert {step.row["task"] for step in find_steps(tiny, ["grasp"], [1], "val")} == {"grasp"}


def test_what_is_not_there_is_named(tiny: ReleaseFolder) -> None:
    with pytest.raises(InputError, match="has no such step"):
        find_steps(tiny, episodes=[999])
    with pytest.raises(InputError, match="has no such step"):
        find_steps(tiny, failure="tool_lost")
    with pytest.raises(InputError, match="has no task push"):
        find_steps(tiny, ["push"])


def test_blocks_that_are_not_here_are_left_out(tiny: ReleaseFolder, tmp_path: Path) -> None:
    shutil.copytree(tiny.path, tmp_path / "tiny")
    part = ReleaseFolder(tiny.manifest, tmp_path)
    shutil.rmtree(tmp_path / "tiny" / "round-1" / "grasp")
    assert {step.row["task"] for step in find_steps(part)} == {"grasp_push"}
    with pytest.raises(MissingFileError, match="not whole on this machine"):
        find_steps(part, ["grasp"])


def test_a_damaged_map_is_not_shown(tiny: ReleaseFolder, tmp_path: Path) -> None:
    shutil.copytree(tiny.path, tmp_path / "tiny")
    path = tmp_path / "tiny" / "round-1" / "grasp" / "val" / "maps.zarr" / "scene" / "c" / "0" / "0" / "0"
    path.chmod(0o644)
    data = bytearray(path.read_bytes())
    data[30] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(IntegrityError, match="scene is damaged"):
        find_steps(ReleaseFolder(tiny.manifest, tmp_path), ["grasp"], split="val")
