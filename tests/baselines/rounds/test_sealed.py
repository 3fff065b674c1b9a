"""What is sealed and what a plan says: the same, or refused by name."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from baselines.rounds import recursion
from baselines.rounds.collect import collect
from baselines.rounds.recursion import recurse
from baselines.rounds.recursion_plan import load_recursion
from baselines.rounds.sealed import check_sealed, note, read_notes
from rema_data.errors import IntegrityError, MissingFileError, RunMismatchError
from rema_data.release.folder import ReleaseFolder
from rema_data.release.manifest import MANIFEST, parse_manifest
from tests.evaluator.fakes import fake_backend

ROOT = Path(__file__).parents[3]
PLAN = """
name = "two"
title = "Two rounds"
description = "For tests."
license = "CC-BY-4.0"
citation = "Nobody."
seed = 7

[[rounds]]
policy = "random"
episodes = { train = 6, val = 2 }
tasks = ["grasp"]

[[rounds.networks]]
network = "round-1/grasp"
primitive = "grasp"
tasks = ["grasp"]

[[rounds]]
policy = { code = "tae", checkpoint = "two/round-1" }
episodes = { train = 4 }
tasks = ["grasp"]
"""


@pytest.fixture
def collected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick_fingerprint: None) -> Path:
    """Both rounds, in the light world, as if their network had been trained before."""
    light = partial(collect, engine="inline", backend=fake_backend())
    monkeypatch.setattr(recursion, "collect", light)
    monkeypatch.setattr(recursion, "trained", lambda *_: True)
    (tmp_path / "plan.toml").write_text(PLAN)
    network = tmp_path / "out" / "checkpoints" / "two" / "round-1" / "grasp.safetensors"
    network.parent.mkdir(parents=True)
    network.write_bytes(b"weights")
    assert [stage.already for stage in again(tmp_path)] == [False, True, False]
    return tmp_path


def again(folder: Path) -> list[recursion.Stage]:
    return list(recurse(load_recursion(folder / "plan.toml"), folder / "out"))


def test_the_same_plan_is_done(collected: Path) -> None:
    assert all(stage.already for stage in again(collected))


def test_another_seed_is_another_plan(collected: Path) -> None:
    (collected / "plan.toml").write_text(PLAN.replace("seed = 7", "seed = 8"))
    with pytest.raises(RunMismatchError, match="two-round-1 was drawn with the seed 7, not 8.* round 1") as caught:
        again(collected)
    assert "another name" in caught.value.hint


def test_a_round_that_other_networks_played(collected: Path) -> None:
    networks = collected / "out" / "checkpoints" / "two"
    (networks / "round-1" / "grasp.safetensors").write_bytes(b"trained again elsewhere")
    with pytest.raises(RunMismatchError, match=r"two was played by other networks \(two/round-1/grasp\) than round 2"):
        again(collected)
    shutil.rmtree(networks / "round-1")
    with pytest.raises(MissingFileError, match="no networks two/round-1 in"):
        again(collected)
    (networks / "round-1").mkdir()
    (networks / "round-1" / "grasp.safetensors").write_bytes(b"trained again elsewhere")
    (networks / "players.json").unlink()  # as of a release that was collected before they were noted
    assert all(stage.already for stage in again(collected))


@pytest.mark.parametrize("name", ["rema-v0", "rema-v1"])
def test_the_published_rounds_are_those_of_their_plan(name: str) -> None:
    plan, releases = load_recursion(ROOT / "manifests" / "plans" / f"{name}.toml"), ROOT / "releases"
    if not (releases / plan.name).is_dir():
        pytest.skip("the releases come with a clone only")
    for entry in plan.rounds:
        path = releases / entry.release / MANIFEST
        check_sealed(plan, entry, ReleaseFolder(parse_manifest(path.read_bytes(), str(path)), releases))


def test_nothing_of_the_published_recursion_is_done_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """`rema rounds manifests/plans/rema-v1.toml` finds every release and every network."""
    plan, releases = load_recursion(ROOT / "manifests" / "plans" / "rema-v1.toml"), ROOT / "releases"
    if not (releases / plan.name).is_dir():
        pytest.skip("the releases come with a clone only")
    for stage in ("collect", "train"):
        monkeypatch.setattr(recursion, stage, lambda *_, **__: pytest.fail("a sealed stage was begun again"))
    assert all(stage.already for stage in recurse(plan, releases))


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("", 'vary = ["act"]\n', "two-round-1 has no varied episodes, so it is not round 1"),
        (
            'vary = { axes = ["act"], clean = 0.9999999 }\n',
            'vary = { axes = ["act"], clean = 0.01 }\n',
            "has no varied",
        ),
        ('vary = { axes = ["act", "shape"], clean = 0.1 }\n', "", "two-round-1 has episodes that are varied by"),
        ('vary = { axes = ["act"], clean = 0.1 }\n', 'vary = ["shape"]\n', "that are varied by act, so it is not"),
    ],
)
def test_a_round_that_is_varied_in_another_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick_fingerprint: None, before: str, after: str, words: str
) -> None:
    monkeypatch.setattr(recursion, "collect", partial(collect, engine="inline", backend=fake_backend()))
    monkeypatch.setattr(recursion, "trained", lambda *_: True)
    plan = tmp_path / "plan.toml"
    for vary in (before, before, after):
        plan.write_text(PLAN.replace('policy = "random"\n', f'policy = "random"\n{vary}'))
        if vary != after:
            next(recurse(load_recursion(plan), tmp_path / "out"))
    with pytest.raises(RunMismatchError, match=words):
        next(recurse(load_recursion(plan), tmp_path / "out"))


def test_two_writers_lose_no_note(tmp_path: Path) -> None:
    path = tmp_path / "networks" / "stages.json"
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda n: note(path, f"train {n}", {"seconds": n}), range(40)))
    assert {name: value["seconds"] for name, value in json.loads(path.read_text()).items()} == {
        f"train {n}": n for n in range(40)
    }
    path.write_text("{")
    with pytest.raises(IntegrityError, match=r"stages\.json is not JSON"):
        read_notes(path)
