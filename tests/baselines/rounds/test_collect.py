"""From a plan to a sealed release, in a light world: what is stored, and what is refused."""

from __future__ import annotations

import dataclasses
import re
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.rounds.play import draw_scenario
from baselines.rounds.work import work_path
from evaluator.scenarios import load_list
from evaluator.scenarios.varied import Vary
from rema_data.errors import (
    InputError,
    IntegrityError,
    MissingFileError,
    PolicyFailureError,
    RunMismatchError,
    SubmissionError,
)
from rema_data.manifests import manifests_dir
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.registry import register
from rema_data.schema import TASKS, Scenario
from rema_data.store.block import BlockKey
from rema_data.store.tables import outcome_of, situation_of, variation_of
from rema_data.testing import make_release
from tests.baselines.rounds.fakes import collect_fake, tree, write_plan
from tests.evaluator.fakes import FakePolicyProcess, FakeSimulator, fake_backend, fake_fingerprint, fake_observe
from tests.rema_data.verify.damage import flip

pytestmark = pytest.mark.usefixtures("quick_fingerprint")


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
