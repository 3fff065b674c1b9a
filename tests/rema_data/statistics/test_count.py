"""Positives and negatives, counted from the tables that are here."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.errors import IntegrityError
from rema_data.release.folder import ReleaseFolder
from rema_data.schema import TASKS, skill
from rema_data.statistics.count import count
from rema_data.testing import make_release

NAMES = ("grasp", "push", "grasp_grasp_push")


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    return make_release(tmp_path_factory.mktemp("data"), tasks=NAMES, rounds=(1, 3), episodes=10)


def test_every_step_of_every_block(release: ReleaseFolder) -> None:
    """Counted again from the episodes: the step at which each of them ended."""
    rows = {(row.round, row.task, row.split, row.step): row for row in count(release).steps}
    assert len(rows) == 2 * 2 * sum(len(TASKS[task]) for task in NAMES)
    for block in release.manifest.blocks:
        episodes = release.block(block).episodes().to_pylist()
        for step, kind in enumerate(TASKS[block.task]):
            row = rows[(*block.key, step)]
            reached = [episode for episode in episodes if episode["steps"] > step]
            failed = sum(episode["failed_step"] == step for episode in reached)
            assert (row.reached, row.negatives) == (len(reached), failed)
            assert row.positives == row.reached - row.negatives
            assert row.skill == skill(kind)
            assert row.policy == ("" if not reached else "random" if row.last else "reference")
            assert row.last == (step == len(TASKS[block.task]) - 1)


def test_totals(release: ReleaseFolder) -> None:
    totals = count(release).totals()
    assert [row.task for row in totals] == list(NAMES)
    counts = release.manifest.counts
    assert sum(row.episodes for row in totals) == counts["episodes"]
    assert sum(row.executed for row in totals) == counts["steps"]
    assert sum(row.positives for row in totals) == counts["positives"]
    for row in totals:
        assert row.reached == row.positives + row.negatives <= row.episodes <= row.executed


def test_a_part_of_a_release(release: ReleaseFolder, tmp_path: Path) -> None:
    shutil.copytree(release.path, tmp_path / "tiny")
    shutil.rmtree(tmp_path / "tiny" / "round-1" / "push")
    (tmp_path / "tiny" / "round-3" / "grasp" / "val" / "episodes.parquet").unlink()
    found = count(ReleaseFolder(release.manifest, tmp_path))
    missing = {"round-1/push/train", "round-1/push/val", "round-3/grasp/val"}
    assert {block.key.path for block in found.missing} == missing
    assert missing.isdisjoint(f"round-{row.round}/{row.task}/{row.split}" for row in found.steps)
    whole = count(release)
    assert set(found.steps) < set(whole.steps) and not whole.missing
    assert [block["episodes"] for block in found.to_dict()["missing"]] == [10, 2, 2]


def test_a_damaged_table_is_named(release: ReleaseFolder, tmp_path: Path) -> None:
    shutil.copytree(release.path, tmp_path / "tiny")
    path = tmp_path / "tiny" / "round-1" / "push" / "val" / "steps.parquet"
    path.chmod(0o644)
    path.write_bytes(bytes(path.stat().st_size))
    with pytest.raises(IntegrityError, match="push/val/steps.parquet is damaged"):
        count(ReleaseFolder(release.manifest, tmp_path))
