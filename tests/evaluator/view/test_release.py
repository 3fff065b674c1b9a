"""A release in the viewer: its tables row for row, and what is missing or damaged."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import rema_data
from evaluator.view import Viewer, open_source
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import EVIDENCE
from rema_data.testing import make_release


def test_every_episode_of_the_tables_is_a_row(viewer: Viewer, tiny: ReleaseFolder) -> None:
    readers = [tiny.block(block) for block in tiny.blocks()]
    episodes = [row for reader in readers for row in reader.episodes().to_pylist()]
    place_of = ("round", "task", "split", "episode")
    last = {tuple(row[name] for name in place_of): row for reader in readers for row in reader.steps().to_pylist()}
    table = viewer.source.table
    assert len(table) == len(episodes) == 72
    for place, episode in enumerate(episodes):
        row = table.row(place)
        number, task, split, index = key = tuple(episode[name] for name in place_of)
        assert row["id"] == f"round-{number}/{task}/{split}/{index}"
        assert row["outcome"] == ("success" if episode["success"] else "failed")
        for name in (*place_of, "steps", "failure", "failed_step"):
            assert row[name] == episode[name]
        for name in ("policy", "target_shape", "tool0_shape", *EVIDENCE):
            assert row[name] == last[key][name]


def test_an_episode_has_the_steps_and_the_maps_of_the_release(viewer: Viewer, tiny: ReleaseFolder) -> None:
    release = rema_data.load(tiny.path, cache="memory")
    name = next(row["id"] for row in viewer.rows("task=grasp_grasp&sort=-steps")["rows"])
    block, index = name.rsplit("/", 1)
    number, task, split = block.split("/")
    episode = release.episode(int(number.removeprefix("round-")), task, split, int(index))
    told = viewer.episode(name)
    assert told["of"] == 3 and len(told["steps"]) == len(episode.steps) == told["row"]["steps"]
    for step, shown in zip(episode.steps, told["steps"], strict=True):
        assert shown["success"] == step.outcome.success
        assert {cell["name"]: cell["value"] for cell in shown["evidence"]} == step.outcome.evidence()
        seen = viewer.seen(name, shown["step"])
        assert np.array_equal(seen.observation.scene, step.observation.scene)
        assert np.array_equal(seen.observation.mask, step.observation.mask)
        assert seen.situation == step.situation


def test_missing_blocks_are_named_and_the_others_are_shown(copied: Path) -> None:
    shutil.rmtree(copied / "round-2" / "grasp_push" / "train")
    source = open_source(str(copied))
    assert len(source.table) == 62
    (notice,) = source.notices
    assert (
        "1 blocks of tiny are missing or not whole on this machine" in notice.message
        and "round-2/grasp_push/train" in notice.message
    )
    assert notice.hint


def test_a_damaged_table_is_named_and_the_others_are_shown(copied: Path) -> None:
    path = copied / "round-1" / "grasp" / "train" / "steps.parquet"
    path.write_bytes(b"\0" * path.stat().st_size)
    source = open_source(str(copied))
    assert len(source.table) == 62
    (notice,) = source.notices
    assert str(path) in notice.message and "rema verify" in notice.hint


def test_a_release_without_a_whole_table_is_refused(copied: Path) -> None:
    for path in copied.rglob("episodes.parquet"):
        path.write_bytes(b"\0" * path.stat().st_size)
    with pytest.raises(IntegrityError, match="is damaged") as caught:
        open_source(str(copied))
    assert "rema verify" in caught.value.hint


def test_a_release_without_any_block_is_refused(copied: Path) -> None:
    for path in copied.glob("round-*"):
        shutil.rmtree(path)
    with pytest.raises(MissingFileError, match="not whole on this machine"):
        open_source(str(copied))


def test_damaged_maps_are_named_where_they_are_asked_for(copied: Path) -> None:
    (path,) = (path for path in (copied / "round-1/grasp/train/maps.zarr/scene/c").rglob("*") if path.is_file())
    data = bytearray(path.read_bytes())
    data[10:60] = bytes(50)
    path.write_bytes(data)
    viewer = Viewer(open_source(str(copied)))
    with pytest.raises(IntegrityError, match="scene is damaged") as caught:
        viewer.picture("round-1/grasp/train/0", 0, "scene")
    assert "rema verify" in caught.value.hint
    assert viewer.picture("round-1/grasp/val/0", 0, "scene").startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("name", "step", "what", "sentence"),
    [
        ("round-1/grasp/train/99", 0, "scene", "no episode 'round-1/grasp/train/99' in tiny"),
        ("../../etc/passwd", 0, "scene", "no episode"),
        ("round-1/grasp/train/0", 7, "scene", "has no step 7"),
        ("round-1/grasp/train/0", 0, "manifest.json", "no picture 'manifest.json'"),
    ],
)
def test_what_there_is_not_is_named(viewer: Viewer, name: str, step: int, what: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        viewer.picture(name, step, what)
    assert caught.value.hint


def test_varied_episodes_are_told_by_their_cell(tmp_path: Path, viewer: Viewer) -> None:
    varied = make_release(tmp_path, "varied", tasks=("grasp",), episodes=6, varied=True)
    shown = Viewer(open_source(str(varied.path)))
    cells = [row["cell"] for row in (shown.source.table.row(place) for place in range(6))]
    assert cells == [None, "clutter 1", None, "shape 1", None, "mixed 1"]
    assert len(shown.rows("cell=shape 1")["rows"]) == 1
    situation = shown.seen("round-1/grasp/train/5", 0).situation
    assert situation.variation is not None and situation.variation.posts
    assert "cell" not in viewer.source.table.row(0)  # a clean release has no such column
