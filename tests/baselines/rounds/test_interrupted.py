"""A collection that was interrupted, and what was kept of it, in a light world."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from baselines.rounds.play import draw_scenario
from baselines.rounds.work import work_path
from rema_data.errors import InfrastructureError, InputError, IntegrityError, RunMismatchError, StorageError
from rema_data.release.folder import ReleaseFolder
from rema_data.store.block import BlockKey
from tests.baselines.rounds.fakes import collect_fake, interrupted, tree, write_plan
from tests.evaluator.fakes import FakePolicyProcess, fake_backend

pytestmark = pytest.mark.usefixtures("quick_fingerprint")


@pytest.mark.parametrize("after", [0, 4, 8])
def test_an_interrupted_collection_goes_on(tmp_path: Path, finished: ReleaseFolder, after: int) -> None:
    plan = write_plan(tmp_path)
    work = interrupted(plan, tmp_path, after)
    kept = len(list((work / "chunks").glob("*.npz")))
    assert (kept > 0) == (after > 0)
    asked = FakePolicyProcess()
    again = collect_fake(plan, tmp_path, backend=fake_backend(asked)).release
    assert tree(again.path) == tree(finished.path)
    total = sum(block.steps for block in again.manifest.blocks)
    assert asked.asked < total if kept else asked.asked == total


def damage_file(work: Path) -> None:
    path = sorted((work / "chunks").glob("*.npz"))[0]
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def lose_file(work: Path) -> None:
    sorted((work / "chunks").glob("*.npz"))[0].unlink()


def tear_log(work: Path) -> None:
    path = work / "log" / "log-0001.jsonl"
    path.write_bytes(path.read_bytes()[:-20])


def forget_log(work: Path) -> None:
    (work / "log" / "log-0001.jsonl").unlink()


def leave_litter(work: Path) -> None:
    (work / "chunks" / ".round-1-grasp-train-0000000.npz.abc").write_bytes(b"half")
    (work / "sealing" / "round-1" / "grasp").mkdir(parents=True)
    (work / "sealing" / "round-1" / "grasp" / "episodes.parquet").write_bytes(b"half")


@pytest.mark.parametrize("harm", [damage_file, lose_file, tear_log, forget_log, leave_litter])
def test_only_chunks_in_the_log_are_kept(tmp_path: Path, finished: ReleaseFolder, harm: Any) -> None:
    plan = write_plan(tmp_path)
    harm(interrupted(plan, tmp_path, 8))
    assert tree(collect_fake(plan, tmp_path).release.path) == tree(finished.path)


def test_a_full_disk_stops_the_collection_and_a_second_run_finishes_it(
    tmp_path: Path, finished: ReleaseFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    left, sync = 9, os.fsync

    def fill(descriptor: int) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(descriptor)

    plan = write_plan(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fill)
        with pytest.raises(StorageError, match="no space is left"):
            collect_fake(plan, tmp_path)
    assert not (tmp_path / "tiny").exists()
    assert tree(collect_fake(plan, tmp_path).release.path) == tree(finished.path)


def test_a_damaged_line_of_the_log_is_an_error(tmp_path: Path) -> None:
    plan = write_plan(tmp_path)
    path = interrupted(plan, tmp_path, 8) / "log" / "log-0001.jsonl"
    path.write_bytes(path.read_bytes().replace(b"chunk", b"chonk", 1))
    with pytest.raises(IntegrityError, match="line 1 is damaged"):
        collect_fake(plan, tmp_path)


@pytest.mark.parametrize(
    ("changes", "backend", "field"),
    [
        ({"seed = 7": "seed = 8"}, {}, "seed"),
        ({"train = 11": "train = 12"}, {}, "blocks"),
        ({'policy = "random"': 'policy = "random"\nvary = ["act"]'}, {}, "schema_version, blocks"),
        ({}, {"digest": "e"}, "blocks"),
        ({}, {"observation_hash": "other code"}, "code"),
    ],
)
def test_chunks_of_another_plan_are_not_mixed(
    tmp_path: Path, changes: dict[str, str], backend: dict[str, Any], field: str
) -> None:
    work = interrupted(write_plan(tmp_path), tmp_path, 8)
    before = tree(work)
    with pytest.raises(RunMismatchError, match=f"they differ in {field}"):
        collect_fake(write_plan(tmp_path, **changes), tmp_path, backend=fake_backend(**backend))
    assert tree(work) == before


def test_a_text_may_change_until_the_release_is_sealed(tmp_path: Path) -> None:
    interrupted(write_plan(tmp_path), tmp_path, 8)
    done = collect_fake(write_plan(tmp_path, Nobody="Somebody"), tmp_path)
    assert done.release.manifest.citation == "Somebody."


def test_two_collectors_do_not_share_a_folder(tmp_path: Path) -> None:
    work = work_path(tmp_path, "tiny")
    work.mkdir()
    with FileLock(work / ".lock"), pytest.raises(InputError, match="another process"):
        collect_fake(write_plan(tmp_path), tmp_path)


def test_a_lost_episode_stops_the_collection_and_a_second_run_finishes_it(
    tmp_path: Path, finished: ReleaseFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    block = BlockKey(1, "grasp", "train")
    placement = draw_scenario(7, block, 10).placements[0]
    number = round(placement.x_m / 1e-5)
    monkeypatch.setenv("REMA_FAKE", json.dumps({"raise": [number]}))
    plan = write_plan(tmp_path)
    with pytest.raises(InfrastructureError, match="step 0 of episode 10 of round-1/grasp/train was lost"):
        collect_fake(plan, tmp_path)
    assert (work_path(tmp_path, "tiny") / "chunks").exists()
    monkeypatch.delenv("REMA_FAKE")
    assert tree(collect_fake(plan, tmp_path).release.path) == tree(finished.path)
