"""Positives and negatives, counted from the tables that are here."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rema_data.errors import InputError, IntegrityError
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


def test_a_selection(release: ReleaseFolder) -> None:
    whole = count(release)
    part = count(release, tasks=["push"], rounds=3, split="val")
    assert part.steps == tuple(r for r in whole.steps if (r.round, r.task, r.split) == (3, "push", "val"))
    with pytest.raises(InputError, match="has no task fly"):
        count(release, tasks=["fly"])


def test_a_condition(release: ReleaseFolder) -> None:
    """Steps that meet it are counted; episodes are those of which one does."""
    pytest.importorskip("duckdb", reason="conditions need DuckDB, part of the extra `query`")
    where = "step >= 1 and target_shape <> 'I'"
    found = count(release, where=where)
    for row in found.steps:
        (block,) = release.manifest.select([row.task], [row.round], row.split)
        steps = [s for s in release.block(block).steps().to_pylist() if s["step"] >= 1 and s["target_shape"] != "I"]
        of_row = [step["success"] for step in steps if step["step"] == row.step]
        assert (row.reached, row.positives) == (len(of_row), sum(of_row))
    (total,) = [row for row in found.totals() if row.task == "grasp_grasp_push"]
    blocks = release.manifest.select(["grasp_grasp_push"])
    tables = [release.block(block).steps().to_pandas() for block in blocks]
    met = [table[(table.step >= 1) & (table.target_shape != "I")] for table in tables]
    assert total.episodes == sum(table.episode.nunique() for table in met) > 0
    assert total.executed == sum(map(len, met)) > total.episodes
    assert found.to_dict()["where"] == where and "where" not in count(release).to_dict()


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
