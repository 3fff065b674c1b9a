"""From a plan to a sealed release, in a light world: what is stored, what is kept, and what is refused."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import re
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock

from baselines.rounds.play import draw_scenario
from baselines.rounds.work import work_path
from evaluator.scenarios import load_list
from evaluator.scenarios.varied import Vary
from rema_data.errors import (
    InfrastructureError,
    InputError,
    IntegrityError,
    MissingFileError,
    PolicyFailureError,
    RunMismatchError,
    StorageError,
    SubmissionError,
)
from rema_data.manifests import manifests_dir
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.registry import register
from rema_data.schema import TASKS, Scenario
from rema_data.store.block import BlockKey
from rema_data.store.tables import outcome_of, situation_of, variation_of
from rema_data.testing import make_release
from rema_data.verify import Report, verify
from tests.baselines.rounds.fakes import PLAN, collect_fake, tree, write_plan
from tests.evaluator.fakes import FakePolicyProcess, FakeSimulator, fake_backend, fake_fingerprint, fake_observe
from tests.rema_data.verify.damage import flip

pytestmark = pytest.mark.usefixtures("quick_fingerprint")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    """The release of the plan, collected once."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())
        return collect_fake(write_plan(folder), folder).release


def rows(release: ReleaseFolder, key: BlockKey) -> list[dict[str, Any]]:
    (entry,) = [block for block in release.manifest.blocks if block.key == key]
    found: list[dict[str, Any]] = release.block(entry).steps().to_pylist()
    return found


def test_the_release_is_what_the_plan_says(finished: ReleaseFolder) -> None:
    manifest = finished.manifest
    assert [(block.key.path, block.episodes) for block in manifest.blocks] == [
        ("round-1/grasp/train", 12),
        ("round-1/grasp/val", 3),
        ("round-2/grasp_grasp_push/train", 11),
    ]
    assert manifest.blocks[2].policies == ("reference", "reference", "reference", "scripted")
    assert (manifest.title, manifest.fingerprint) == ("Tiny", fake_fingerprint())
    assert find_release(finished.path).manifest.sha256 == manifest.sha256
    assert not work_path(finished.root, "tiny").exists()


def test_steps_follow_from_each_other(finished: ReleaseFolder) -> None:
    """Every stored step is what the world does with its situation and action, and starts where the last one ended."""
    simulator = FakeSimulator()
    for entry in finished.manifest.blocks:
        block = finished.block(entry)
        steps, maps = block.steps().to_pylist(), block.maps()
        depth = maps.read("ee_depth", 0, maps.rows("ee_depth"))
        for episode in block.episodes().to_pylist():
            own = steps[episode["first_step"] :][: episode["steps"]]
            placements = draw_scenario(7, entry.key, episode["episode"]).placements
            grips: tuple[Any, ...] = ()
            pinch = None
            for number, row in enumerate(own):
                situation = situation_of(row, variation_of(episode))
                assert (row["step"], situation.grips, situation.pinch) == (number, grips, pinch)
                assert situation.target == placements[number]
                outcome = simulator.run(situation, row["action"])
                assert outcome_of(row).success == outcome.success == (row["failure"] is None)
                assert np.array_equal(depth[row["ee_row"]], fake_observe(situation).depth + 100)
                grips = grips if outcome.grip is None else (*grips, outcome.grip)
                pinch = outcome.pinch
            assert episode["success"] == (len(own) == len(TASKS[entry.task]) and own[-1]["success"])
            assert all(row["success"] for row in own[:-1])
            assert own[-1]["last"] or not own[-1]["success"]


def test_rounds_and_splits_have_scenes_of_their_own() -> None:
    drawn = {
        draw_scenario(7, BlockKey(round_, "grasp", split), index).placements
        for round_ in (1, 2)
        for split in ("train", "val")
        for index in range(20)
    }
    assert len(drawn) == 80


def test_the_bytes_do_not_depend_on_the_workers(tmp_path: Path, finished: ReleaseFolder) -> None:
    again = collect_fake(write_plan(tmp_path), tmp_path, engine="process", workers=3).release
    assert tree(again.path) == tree(finished.path)


def test_the_data_do_not_depend_on_the_size_of_a_chunk(tmp_path: Path, finished: ReleaseFolder) -> None:
    again = collect_fake(write_plan(tmp_path), tmp_path, chunk_episodes=100).release
    changed = {name for name, sha256 in tree(again.path).items() if tree(finished.path)[name] != sha256}
    assert not any(name.startswith("round-") for name in changed)


def test_a_sealed_plan_is_not_collected_again(tmp_path: Path, finished: ReleaseFolder) -> None:
    before, work = tree(finished.path), work_path(finished.root, "tiny")
    work.mkdir()  # killed after the release had its name
    again = collect_fake(write_plan(tmp_path), finished.root, backend=fake_backend(open_policy=None))
    assert again.already and again.release.manifest == finished.manifest
    assert tree(finished.path) == before and not work.exists()


@pytest.mark.parametrize("kind", ["a frozen scenario", "a scenario of a suite", "a scene of the other split"])
def test_a_scene_that_is_kept_for_evaluation_is_not_sealed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    suite = load_list("grasp", "test", "hard-v1").scenarios
    shaped = next(one for one in suite if one.variation is not None and one.variation.axis == "shape")
    frozen = {"a frozen scenario": load_list("grasp").scenarios[4], "a scenario of a suite": shaped}

    def leaking(seed: int, block: BlockKey, index: int, vary: Vary | None) -> Scenario:
        drawn = draw_scenario(seed, block, index, vary)
        if (block.split, index) != ("val", 1):
            return drawn
        other = frozen.get(kind) or draw_scenario(seed, block._replace(split="train"), 7)
        first = other.placements[0]
        return dataclasses.replace(drawn, placements=(first, *drawn.placements[1:]))

    monkeypatch.setattr("baselines.rounds.play.draw_scenario", leaking)
    with pytest.raises(IntegrityError, match="row 1 of round-1/grasp/val in tiny may not be sealed") as caught:
        collect_fake(write_plan(tmp_path), tmp_path)
    named = re.findall(r"(hard-v1|v\d)/grasp/test/(\d+)", str(caught.value))
    assert [int(index) for _, index in named] == ([frozen[kind].index] if kind in frozen else [])
    assert [name == "hard-v1" for name, _ in named] == [kind == "a scenario of a suite"] * len(named)
    assert not (tmp_path / "tiny").exists()


@pytest.mark.parametrize(
    ("old", "new"), [("seed = 7", "seed = 8"), ("Nobody", "Somebody"), ("train = 11", "train = 12")]
)
def test_a_sealed_release_belongs_to_one_plan(tmp_path: Path, finished: ReleaseFolder, old: str, new: str) -> None:
    before = tree(finished.path)
    with pytest.raises(RunMismatchError, match="made by another plan"):
        collect_fake(write_plan(tmp_path, **{old: new}), finished.root)
    assert tree(finished.path) == before


def test_a_published_name_belongs_to_one_plan(
    tmp_path: Path, finished: ReleaseFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Said before anything is played; the plan that made it may make it again, anywhere."""
    (tmp_path / "manifests").mkdir()
    (tmp_path / "manifests" / "scenarios").symlink_to(manifests_dir() / "scenarios")
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    register(finished.manifest)
    with pytest.raises(
        RunMismatchError, match=r"plan\.toml: tiny is a published release, made by another plan"
    ) as caught:
        collect_fake(write_plan(tmp_path, **{"seed = 7": "seed = 8"}), tmp_path / "other")
    assert caught.value.hint == "give the plan another name" and not (tmp_path / "other").exists()
    assert collect_fake(write_plan(tmp_path), finished.root).already
    again = collect_fake(write_plan(tmp_path), tmp_path / "again")
    assert not again.already and again.release.manifest.sha256 == finished.manifest.sha256


def test_a_folder_of_that_name_is_not_written_to(tmp_path: Path) -> None:
    (tmp_path / "tiny").mkdir()
    with pytest.raises(RunMismatchError, match="is not a sealed release"):
        collect_fake(write_plan(tmp_path), tmp_path)
    assert list((tmp_path / "tiny").iterdir()) == []


class Stopper(FakePolicyProcess):
    """Presses Ctrl-C in the middle of an answer."""

    def __init__(self, after: int) -> None:
        super().__init__()
        self.left = after

    def act(self, batch: Any, situations: Any) -> list[Any]:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().act(batch, situations)


def interrupted(plan: Path, output: Path, after: int, **backend: Any) -> Path:
    with pytest.raises(KeyboardInterrupt):
        collect_fake(plan, output, backend=fake_backend(Stopper(after), **backend))
    return work_path(output, "tiny")


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


def test_a_policy_that_gives_no_action_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        PolicyFailureError, match=r"policy random .* round-1/grasp/train: exception: ValueError"
    ) as caught:
        collect_fake(write_plan(tmp_path), tmp_path, backend=fake_backend(FakePolicyProcess(faulty=1.0)))
    assert caught.value.facts["episode"] == 0


def test_a_policy_that_cannot_be_loaded_is_reported_first(tmp_path: Path) -> None:
    @contextmanager
    def broken(spec: Any, *_: Any) -> Any:
        if spec.name == "scripted":  # it plays in the second round only
            raise SubmissionError("policy scripted cannot be used", hint="fix it")
        yield FakePolicyProcess()

    with pytest.raises(SubmissionError):
        collect_fake(write_plan(tmp_path), tmp_path, backend=fake_backend(open_policy=broken))
    assert not (work_path(tmp_path, "tiny") / "chunks").exists()


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


CHILD = """
name = "tiny-child"
title = "Tiny child"
description = "For tests."
license = "CC-BY-4.0"
citation = "Nobody."
seed = 7
parent = "tiny-parent"
[[rounds]]
reuse = true
[[rounds]]
policy = "scripted"
episodes = { train = 6 }
tasks = ["push"]
"""


def test_a_round_of_the_parent_is_reused(tmp_path: Path) -> None:
    parent = make_release(tmp_path, "tiny-parent", tasks=("grasp",), episodes=5)
    before = tree(parent.path)
    done = collect_fake(write_plan(tmp_path, CHILD), tmp_path).release
    holders = [(block.key.path, block.holder) for block in done.manifest.blocks]
    assert holders == [
        ("round-1/grasp/train", "tiny-parent"),
        ("round-1/grasp/val", "tiny-parent"),
        ("round-2/push/train", "tiny-child"),
    ]
    assert done.manifest.parent is not None and done.manifest.parent.sha256 == parent.manifest.sha256
    assert len(done.blocks()) == 3 and tree(parent.path) == before


def test_a_parent_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    make_release(tmp_path, "tiny-parent", tasks=("grasp",), episodes=5)
    plan = write_plan(tmp_path, CHILD)
    with pytest.raises(InputError, match="lie in tiny-parent, which is not in"):
        collect_fake(plan, tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "tiny-parent").mkdir(parents=True)
    with pytest.raises(InputError, match="or not whole") as caught:
        collect_fake(plan, tmp_path / "elsewhere")
    assert caught.value.hint == f"collect beside it: --output {tmp_path}"
    shutil.rmtree(tmp_path / "elsewhere")
    shutil.copytree(tmp_path / "tiny-parent", tmp_path / "elsewhere" / "tiny-parent")
    flip(tmp_path / "elsewhere" / "tiny-parent" / "round-1" / "grasp" / "train" / "steps.parquet", 100)
    with pytest.raises(RunMismatchError, match="not that of tiny-parent") as other:
        collect_fake(plan, tmp_path / "elsewhere")
    assert other.value.hint == f"collect beside that release: --output {tmp_path}"
    text = CHILD.replace("reuse = true\n", "reuse = true\n[[rounds]]\nreuse = true\n")
    with pytest.raises(InputError, match="has no round 2"):
        collect_fake(write_plan(tmp_path, text), tmp_path)
    shutil.rmtree(tmp_path / "tiny-parent")
    with pytest.raises((InputError, MissingFileError), match="tiny-parent"):
        collect_fake(write_plan(tmp_path, CHILD), tmp_path)


VARY = 'policy = "random"\nvary = { axes = ["clutter", "shape", "sense"], clean = 0.3 }'
VARIED = PLAN.replace('policy = "random"', VARY)
"""Varied in round 1 alone."""
CLEAN_PLAN = "bafe193410b5d25ba427e4bda4ee338cfed51da245af7ecffae73dfc21b0a64a"
"""What the plan of these tests was called before plans could vary."""


def test_the_identity_of_a_clean_plan_stays(finished: ReleaseFolder) -> None:
    """Released plans have this one: no schema version, field or draw may change it."""
    assert finished.manifest.plan_sha256 == CLEAN_PLAN
    assert finished.manifest.schema_version == 1


def test_clean_episodes_are_drawn_as_ever() -> None:
    """Those of the sample, which was collected before there were varied ones."""
    sample = find_release("rema-sample")
    for entry in sample.manifest.blocks:
        block = sample.block(entry)
        seeds = dict(zip(*(block.episodes()[name].to_pylist() for name in ("episode", "seed")), strict=True))
        for row in block.steps().to_pylist():
            drawn = draw_scenario(seeds[row["episode"]], entry.key, row["episode"])
            assert situation_of(row, None).target == drawn.placements[row["step"]]


@pytest.mark.parametrize(("text", "goes_on"), [(VARIED, False), (PLAN, True)])
def test_other_code_of_the_axes_makes_other_varied_episodes_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, goes_on: bool
) -> None:
    """A collection that varies nothing goes on after the axes have changed."""
    plan = write_plan(tmp_path, text)
    recorded = json.loads((interrupted(plan, tmp_path, 8) / "plan.json").read_bytes())
    assert (recorded["code"] == "fake") == goes_on
    monkeypatch.setattr("baselines.rounds.collect.source_digest", lambda *_: "that of an update")
    if goes_on:
        assert collect_fake(plan, tmp_path).release
    else:
        with pytest.raises(RunMismatchError, match="they differ in code"):
            collect_fake(plan, tmp_path)


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> ReleaseFolder:
    folder = tmp_path_factory.mktemp("varied")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.rounds.collect.call_in_child", lambda target: fake_fingerprint())
        return collect_fake(write_plan(folder, VARIED), folder).release


def test_a_varied_episode_can_be_played_again_from_its_row(varied: ReleaseFolder) -> None:
    assert varied.manifest.schema_version == 2
    simulator, cells = FakeSimulator(), set()
    for entry in varied.manifest.blocks:
        block = varied.block(entry)
        assert block.version() == 2  # all blocks of a release, though only one of its rounds is varied
        steps, maps = block.steps().to_pylist(), block.maps()
        for episode in block.episodes().to_pylist():
            variation = variation_of(episode)
            drawn = draw_scenario(7, entry.key, episode["episode"], varied_by(entry.key))
            assert drawn.variation == variation
            for row in steps[episode["first_step"] :][: episode["steps"]]:
                situation = situation_of(row, variation)
                assert situation.target == drawn.placements[row["step"]]
                assert outcome_of(row).failure == simulator.run(situation, row["action"]).failure
                seen = maps.read("ee_depth", row["ee_row"], row["ee_row"] + 1)
                assert np.array_equal(seen[0], fake_observe(situation).depth + 100)
            if variation is not None:
                cells.add(variation.axis)
    assert len(cells) > 1 and not found_by(verify(varied))


def found_by(report: Report) -> set[str]:
    """Kinds of findings, but for those that the light world does not keep in any episode."""
    return report.counts.keys() - {"labels", "maps", "actions"}


def varied_by(key: BlockKey) -> Vary | None:
    return Vary(("clutter", "shape", "sense"), 0.3) if key.round == 1 else None


def test_varied_episodes_are_the_same_with_any_workers_and_chunks(tmp_path: Path, varied: ReleaseFolder) -> None:
    again = collect_fake(write_plan(tmp_path, VARIED), tmp_path, engine="process", workers=3).release
    assert tree(again.path) == tree(varied.path)
    (tmp_path / "other").mkdir()
    larger = collect_fake(write_plan(tmp_path, VARIED), tmp_path / "other", chunk_episodes=100).release
    changed = {name for name, sha256 in tree(larger.path).items() if tree(varied.path)[name] != sha256}
    assert not any(name.startswith("round-") for name in changed)


def test_a_varied_round_continues_a_clean_release(tmp_path: Path) -> None:
    """Blocks of both versions in one release; a clean round that continues it has the columns of the newest."""
    collect_fake(write_plan(tmp_path), tmp_path)
    reuse = 'parent = "tiny"\n' + PLAN[: PLAN.index("[[rounds]]")] + "[[rounds]]\nreuse = true\n\n" * 2
    third = '[[rounds]]\npolicy = "random"\nepisodes = { train = 9 }\ntasks = ["grasp"]\n'
    middle = reuse.replace('"tiny"\ntitle', '"middle"\ntitle') + third + 'vary = ["shape"]\n'
    both = collect_fake(write_plan(tmp_path, middle), tmp_path).release
    assert both.manifest.schema_version == 2
    assert [both.block(block).version() for block in both.manifest.blocks] == [1, 1, 1, 2]
    assert not found_by(verify(both))
    last = reuse.replace('"tiny"\ntitle', '"last"\ntitle').replace('"tiny"', '"middle"')
    whole = collect_fake(write_plan(tmp_path, last + "[[rounds]]\nreuse = true\n\n" + third), tmp_path).release
    assert [whole.block(block).version() for block in whole.manifest.blocks] == [1, 1, 1, 2, 2]
    column = whole.block(whole.manifest.blocks[-1]).episodes()["variation"]
    assert column.null_count == len(column) and not found_by(verify(whole))
