"""What a user opens: found by name or folder, tables and episodes as written, selections that mean one thing."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rema_data
from rema_data.errors import InputError, MissingFileError
from rema_data.release.folder import ReleaseFolder, downloads_folder
from rema_data.release.registry import register
from rema_data.schema import Episode, Observation, Step
from rema_data.store.block import BlockKey
from rema_data.store.columns import EPISODE_COLUMNS, STEP_COLUMNS
from rema_data.testing import make_release, synthetic_episode
from tests.rema_data.loader.conftest import KEYS


def same_observation(a: Observation, b: Observation) -> bool:
    pairs = [(a.scene, b.scene), (a.depth, b.depth), (a.mask, b.mask)]
    return all(x.dtype == y.dtype and np.array_equal(x, y) for x, y in pairs)


def without_maps(step: Step) -> Step:
    return dataclasses.replace(step, observation=None)  # type: ignore[arg-type]


def emitted(key: BlockKey, index: int) -> Episode:
    """A synthetic episode whose outcomes hold what the next step has in hand, as those of the simulator do."""
    episode = synthetic_episode(key, index, seed=3, success=0.6)
    steps = list(episode.steps)
    for at, following in enumerate(steps[1:]):
        new = following.situation.grips[len(steps[at].situation.grips) :]
        held = dataclasses.replace(steps[at].outcome, grip=next(iter(new), None), pinch=following.situation.pinch)
        steps[at] = dataclasses.replace(steps[at], outcome=held)
    return dataclasses.replace(episode, steps=tuple(steps))


@pytest.mark.parametrize("key", KEYS, ids=lambda key: key.path)
def test_episode_is_the_one_that_was_written(release: rema_data.Release, key: BlockKey) -> None:
    for index in (0, 1, 9) if key.split == "train" else (0, 1):
        read, written = release.episode(*key, index), emitted(key, index)
        assert dataclasses.replace(read, steps=()) == dataclasses.replace(written, steps=())
        assert [without_maps(step) for step in read.steps] == [without_maps(step) for step in written.steps]
        pairs = zip(read.steps, written.steps, strict=True)
        assert all(same_observation(a.observation, b.observation) for a, b in pairs)


@pytest.mark.parametrize("index", [-1, 10])
def test_episode_that_is_not_there(release: rema_data.Release, index: int) -> None:
    with pytest.raises(InputError, match="0 to 9"):
        release.episode(1, "grasp", "train", index)


def test_tables_have_every_row_and_column(release: rema_data.Release) -> None:
    steps, episodes = release.to_pandas(), release.episodes
    assert list(steps) == [column.name for column in STEP_COLUMNS]
    assert list(episodes) == [column.name for column in EPISODE_COLUMNS]
    assert (len(episodes), len(steps)) == (release.manifest.counts["episodes"], release.manifest.counts["steps"])
    assert int(episodes.success.sum()) == release.manifest.counts["positives"]
    assert steps.index.is_unique and episodes.index.is_unique


def test_dataset_of_all_steps_is_the_table(release: rema_data.Release) -> None:
    table, steps = release.steps(which="all").table, release.to_pandas()
    for name in table:
        ours, theirs = table[name].astype(object), steps[name].astype(object)
        assert ours.where(ours.notna(), None).tolist() == theirs.where(theirs.notna(), None).tolist(), name


def test_selections(release: rema_data.Release) -> None:
    steps = release.to_pandas()
    cases = {
        "last": steps["last"],
        "picks": ~steps["last"],
        "all": steps["last"] | True,
    }
    for which, keep in cases.items():
        table = release.steps(["grasp_push", "grasp"], "train", [2], which=which).table  # type: ignore[arg-type]
        wanted = steps[
            keep & steps.task.isin(["grasp", "grasp_push"]) & (steps.split == "train") & (steps["round"] == 2)
        ]
        assert table[["task", "episode", "step"]].astype(object).values.tolist() == (
            wanted[["task", "episode", "step"]].astype(object).values.tolist()
        )
        assert list(table.index) == list(range(len(table)))
    skilled = release.steps(skills="grasp", which="all").table
    assert len(skilled) == (steps.skill == "grasp").sum() and set(skilled.task) == set(steps.task)
    assert list(release.steps("grasp").table.task.cat.categories) == ["grasp"]
    assert len(release.steps(rounds=1)) == (steps["last"] & (steps["round"] == 1)).sum()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tasks": ["push"]}, "no task push"),
        ({"split": "test"}, "no split test"),
        ({"rounds": [9]}, "no round 9"),
        ({"skills": ["push"]}, "no step of the skill push"),
        ({"tasks": ["grasp"], "which": "picks"}, "no step of this selection"),
        ({"which": "first"}, "which='first'"),
        ({"maps": "float16"}, "maps='float16'"),
    ],
)
def test_selection_that_cannot_be(release: rema_data.Release, options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        release.steps(**options)  # type: ignore[arg-type]
    assert caught.value.hint


def test_absent_blocks_name_the_command(sealed: ReleaseFolder, places: Path) -> None:
    copy = ReleaseFolder(sealed.manifest, places / "data")
    shutil.copytree(sealed.path, copy.path, ignore=shutil.ignore_patterns("grasp_push"))
    part = rema_data.load(copy.path)
    with pytest.raises(MissingFileError, match=r"copy them again"):
        part.steps(["grasp", "grasp_push"])
    with pytest.raises(MissingFileError):
        part.steps()
    with pytest.raises(MissingFileError):
        part.episode(1, "grasp_push", "train", 0)
    here = part.steps(["grasp", "grasp_grasp_push"], which="all")
    assert len(here) == len(part.to_pandas()) and set(part.episodes.task) == {"grasp", "grasp_grasp_push"}
    whole = rema_data.Release(sealed).steps(["grasp", "grasp_grasp_push"], which="all")
    assert here.fingerprint == whole.fingerprint and here.table.equals(whole.table)
    assert (here[:].ee_depth == whole[:].ee_depth).all() and (here[:].scene == whole[:].scene).all()
    episode = part.episode(2, "grasp_grasp_push", "val", 1)
    assert same_observation(episode.steps[0].observation, emitted(KEYS[-1], 1).steps[0].observation)


def test_found_by_name_and_by_default(small: ReleaseFolder) -> None:
    register(small.manifest)
    with pytest.raises(MissingFileError, match="rema download tiny"):
        rema_data.load("tiny")
    downloads_folder().mkdir(parents=True)
    shutil.copytree(small.path, downloads_folder() / "tiny")
    for opened in (rema_data.load("tiny"), rema_data.load()):
        assert (opened.name, opened.fingerprint) == ("tiny", small.manifest.sha256)
    with pytest.raises(InputError, match="neither"):
        rema_data.load("tny")


def test_opening_a_decoded_release_needs_neither_torch_nor_pandas(small: ReleaseFolder) -> None:
    rema_data.load(small.path).steps()
    code = (
        "import sys, rema_data; r = rema_data.load(sys.argv[1]); r.cache.index; r.cache.maps;"
        "print(*sorted({'torch', 'pandas', 'filelock'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code, str(small.path)], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


@pytest.mark.parametrize("rounds", [1, np.int64(1), [1], (np.int16(1),), np.array([1]), range(1, 2), {1}])
def test_rounds_in_any_form(release: rema_data.Release, rounds: Any) -> None:
    assert release.steps(rounds=rounds).fingerprint == release.steps(rounds=[1]).fingerprint


@pytest.mark.parametrize("split", ["train", ["train"], ("train",), np.array(["train"]), np.str_("train")])
def test_splits_in_any_form(release: rema_data.Release, split: Any) -> None:
    assert release.steps(split=split).fingerprint == release.steps(split="train").fingerprint
    assert release.steps(split=["val", "train"]).fingerprint == release.steps().fingerprint


@pytest.mark.parametrize(
    "wrong",
    [
        {"rounds": True},
        {"rounds": 1.0},
        {"rounds": "1"},
        {"rounds": [[1]]},
        {"split": 1},
        {"split": [["train"]]},
        {"tasks": 5},
    ],
)
def test_selections_of_the_wrong_kind_are_refused(release: rema_data.Release, wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"^{next(iter(wrong))}=.* is not a "):
        release.steps(**wrong)


def test_relative_paths_are_meant_from_where_they_were_given(
    places: Path, small: ReleaseFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = rema_data.load(Path("data") / small.manifest.name, cache="caches")
    made_here = ReleaseFolder(small.manifest, Path("data"))
    (places / "elsewhere").mkdir()
    monkeypatch.chdir(places / "elsewhere")
    assert len(opened.steps(tasks=["grasp"])) > 0 and opened.cache.folder is not None
    assert opened.cache.folder.is_relative_to(places / "caches") and list((places / "elsewhere").iterdir()) == []
    assert made_here.blocks() == small.blocks()


def test_a_block_that_came_later_is_not_left_out(tmp_path: Path) -> None:
    """A selection is whole or an error: what is decoded are the blocks that were there at first."""
    made = make_release(tmp_path, "tiny", ("grasp", "push"), episodes=8)
    away = tmp_path / "push"
    shutil.move(made.path / "round-1" / "push", away)
    release = rema_data.load(made.path, cache="memory")
    assert len(release.steps(tasks=["grasp"])) > 0
    shutil.move(away, made.path / "round-1" / "push")
    later = (
        lambda: release.steps(),
        lambda: release.episode(1, "push", "train", 0),
        lambda: next(release.iter_episodes()),
    )
    for ask in later:
        with pytest.raises(MissingFileError, match="opened before round-1/push/train") as caught:
            ask()
        assert "rema_data.load('tiny')" in caught.value.hint
    assert len(rema_data.load(made.path, cache="memory").steps()) > len(release.steps(tasks=["grasp"]))
