"""What differs between two releases is found, by block, row and column, and nothing else."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from rema_data.diff import BlockDiff, ReleaseDiff, TableDiff, diff_releases
from rema_data.errors import IntegrityError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.seal import Description, seal
from rema_data.store.block import EPISODES, STEPS, BlockKey, BlockReader, BlockWriter, encode_episodes
from rema_data.testing import FINGERPRINT, make_release, synthetic_episode
from tests.rema_data.verify.damage import change_cell, copy, location, parquet, reseal

TRAIN, VAL = BlockKey(1, "grasp_push", "train"), BlockKey(1, "grasp_push", "val")
GRASP = BlockKey(1, "grasp", "train")


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("data"), episodes=10)


@pytest.fixture
def other(release: ReleaseFolder, tmp_path: Path) -> ReleaseFolder:
    """A copy, to be changed."""
    return copy(release, tmp_path)


def the_block(found: ReleaseDiff) -> BlockDiff:
    """The one block that differs."""
    (block,) = found.blocks
    assert not found.equal and found.equal_blocks == 3
    return block


def test_a_release_and_its_copy(release: ReleaseFolder, other: ReleaseFolder) -> None:
    found = diff_releases(release, other)
    assert found.equal and found.equal_blocks == 4 and not found.fields
    assert found.sha256[0] == found.sha256[1]


def test_the_same_data_made_again_under_another_name(release: ReleaseFolder, tmp_path: Path) -> None:
    found = diff_releases(release, make_release(tmp_path, name="again", episodes=10))
    assert found.equal and found.fields == ("name", "title")


def test_a_cell(release: ReleaseFolder, other: ReleaseFolder) -> None:
    changed = change_cell(other, TRAIN, STEPS, "lift_m", 3, 0.125)
    block = the_block(diff_releases(release, changed))
    assert (block.block, block.state) == (TRAIN.path, "changed")
    assert block.tables == (TableDiff("steps", 0, 0, 1, {"lift_m": 1}),)
    assert the_block(diff_releases(changed, release)).tables == block.tables


@pytest.mark.parametrize(("value", "name"), [(None, "failure"), ("slipped", "failure"), (2**63, "seed")])
def test_nulls_and_other_types(release: ReleaseFolder, other: ReleaseFolder, value: object, name: str) -> None:
    table = release.block(next(b for b in release.manifest.blocks if b.key == GRASP)).episodes()
    row = next(at for at, old in enumerate(table["failure"].to_pylist()) if old not in (None, "slipped"))
    block = the_block(diff_releases(release, change_cell(other, GRASP, EPISODES, name, row, value)))
    assert block.tables == (TableDiff("episodes", 0, 0, 1, {name: 1}),)


def test_other_bytes_of_the_same_rows(release: ReleaseFolder, other: ReleaseFolder) -> None:
    place = location(other, VAL, STEPS)
    again = reseal(other, {place: parquet(pq.read_table(other.root / place))})
    block = the_block(diff_releases(release, again))
    assert (block.state, block.tables) == ("stored differently", ())


def test_episodes_and_maps(release: ReleaseFolder, tmp_path: Path) -> None:
    """A block without its episode 0 and with one of another seed: rows move, and are compared all the same."""
    staging = tmp_path / ".staging"
    keys = [block.key for block in release.manifest.blocks]
    for key in keys:
        shutil.copytree(release.path / key.path, staging / key.path)
    shutil.rmtree(staging / TRAIN.path)
    writer = BlockWriter(staging / TRAIN.path)
    episodes = [synthetic_episode(TRAIN, number, seed=7 if number == 4 else 0) for number in range(1, 10)]
    writer.append(*encode_episodes(episodes))
    writer.close()
    about = Description("tiny", "The release tiny", "Synthetic: for tests only.", "CC-BY-4.0", "The rema authors")
    changed = seal(staging, tmp_path, about, keys, fingerprint=FINGERPRINT)
    block = the_block(diff_releases(release, changed))
    of_episodes, of_steps = block.tables
    old = [synthetic_episode(TRAIN, number) for number in (0, 4)]
    shared = list(zip(old[1].steps, episodes[3].steps, strict=False))
    assert (of_episodes.only_a, of_episodes.only_b, of_episodes.changed) == (1, 0, 1)
    assert of_episodes.columns["seed"] == 1
    assert of_steps.only_a == len(old[0].steps) + len(old[1].steps) - len(shared)
    assert of_steps.only_b == len(episodes[3].steps) - len(shared)
    assert of_steps.changed == len(shared) == of_steps.columns["scene"] == of_steps.columns["target_x_m"]
    hands = [one.observation.depth.tobytes() != new.observation.depth.tobytes() for one, new in shared]
    assert of_steps.columns.get("ee_depth", 0) == sum(hands)
    assert not {"scene_row", "ee_row", "first_step"} & (set(of_steps.columns) | set(of_episodes.columns))
    assert block.episodes == (10, 9)


def test_blocks_of_one_side(release: ReleaseFolder, tmp_path: Path) -> None:
    more = make_release(tmp_path, tasks=("grasp", "push"), episodes=10)
    found = diff_releases(release, more)
    states = {block.block: (block.state, block.episodes) for block in found.blocks}
    assert found.equal_blocks == 2
    assert states == {
        "round-1/grasp_push/train": ("only in A", (10, 0)),
        "round-1/grasp_push/val": ("only in A", (2, 0)),
        "round-1/push/train": ("only in B", (0, 10)),
        "round-1/push/val": ("only in B", (0, 2)),
    }


def test_blocks_that_are_not_here(release: ReleaseFolder, other: ReleaseFolder) -> None:
    """Equal hashes need no files; where they differ, the command that fetches them is named."""
    shutil.rmtree(other.path / GRASP.path)
    assert diff_releases(release, other).equal
    changed = change_cell(other, VAL, STEPS, "lift_m", 0, 0.5)
    (changed.path / VAL.path / STEPS).unlink()
    block = the_block(diff_releases(release, changed))
    assert block.state == "not compared" and block.fix


def test_a_table_that_contradicts_itself(release: ReleaseFolder, other: ReleaseFolder) -> None:
    changed = change_cell(other, TRAIN, EPISODES, "episode", 1, 0)
    with pytest.raises(IntegrityError, match="two rows of one episode"):
        diff_releases(release, changed)


def test_everything_is_ready_for_json(release: ReleaseFolder, other: ReleaseFolder) -> None:
    found = diff_releases(release, change_cell(other, TRAIN, STEPS, "lift_m", 3, 0.125))
    printed = json.loads(json.dumps(found.to_dict()))
    assert printed["equal"] is False
    assert printed["blocks"][0]["tables"][0]["columns"] == {"lift_m": 1}
    assert dataclasses.asdict(found)["blocks"][0]["state"] == "changed"


def test_every_map_that_differs_is_counted(release: ReleaseFolder, tmp_path: Path) -> None:
    """Counted again from the decoded maps."""
    changed = make_release(tmp_path, episodes=10, seed=1)
    found = {block.block: block for block in diff_releases(release, changed).blocks}
    for entry in release.manifest.blocks:
        (twin,) = (block for block in changed.manifest.blocks if block.key == entry.key)
        sides = [(reader, reader.steps().to_pandas()) for reader in (release.block(entry), changed.block(twin))]
        joined = sides[0][1].merge(sides[1][1], on=["episode", "step"])
        for name, pointer in (("scene", "scene_row"), ("ee_depth", "ee_row"), ("ee_mask", "ee_row")):
            a, b = (
                _rows(reader, name)[joined[f"{pointer}_{side}"]] for (reader, _), side in zip(sides, "xy", strict=True)
            )
            differ = int((a != b).reshape(len(a), -1).any(axis=1).sum())
            (steps,) = (table for table in found[entry.key.path].tables if table.table == "steps")
            assert steps.columns.get(name, 0) == differ


def _rows(reader: BlockReader, name: str) -> np.ndarray:
    maps = reader.maps()
    return maps.read(name, 0, maps.rows(name))
