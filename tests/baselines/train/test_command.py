"""``rema train`` on the command line."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import pytest
from click.testing import CliRunner

import rema_data
from baselines.tae.network import Architecture
from baselines.train import pictures
from baselines.train.command import train
from baselines.train.config import TrainingConfig
from evaluator.cli.main import cli


def command(release: rema_data.Release, output: Path, *more: str) -> list[str]:
    words = ["train", "--release", str(release.folder.path), "--tasks", "grasp,grasp_push", "--primitive", "grasp"]
    small = ["--output", str(output), "--updates", "4", "--validate-every", "2", "--width", "4"]
    return [*words, *small, *more]


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))


def test_a_network_with_its_card_and_pictures(release: rema_data.Release, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "maps.png"
    done = CliRunner().invoke(cli, command(release, tmp_path / "out", "--pictures", str(picture)))
    assert done.exit_code == 0, done.output
    assert "grasp.safetensors is trained: validation AUC" in done.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    again = CliRunner().invoke(cli, command(release, tmp_path / "out", "--json"))
    assert again.exit_code == 0 and json.loads(again.stdout)["architecture"]["width"] == 4


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--skills", "push"), "skill push"),
        (("--learning-rate", "0"), "learning_rate"),
        (("--tasks", "juggle"), "juggle"),
        (("--release", "nowhere"), "nowhere"),
        (("--updates", "0"), "updates"),
        (("--share", "grasp"), "'grasp' is not a share"),
        (("--share", "push=2"), "shares names 'push'"),
        (("--name", "push.pt"), "'push.pt' cannot name a network"),
        (("--name", "../grasp"), "'../grasp' cannot name a network"),
    ],
)
def test_bad_input_is_named(release: rema_data.Release, tmp_path: Path, more: tuple[str, ...], words: str) -> None:
    done = CliRunner().invoke(cli, command(release, tmp_path / "out", *more))
    assert done.exit_code == 2 and words in done.output
    assert not (tmp_path / "out").exists()


def test_pictures_that_cannot_be_drawn_are_refused_before_the_training(
    release: rema_data.Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "find_spec", lambda name: None)
    done = CliRunner().invoke(cli, command(release, tmp_path / "out", "--pictures", str(tmp_path / "maps.png")))
    assert done.exit_code == 2 and "rema[report]" in done.output and not (tmp_path / "out").exists()


def test_one_training_a_seed(release: rema_data.Release, tmp_path: Path) -> None:
    """Each in a folder of its own, equal to the training with that seed alone."""
    out = tmp_path / "out"
    done = CliRunner().invoke(cli, command(release, out, "--seeds", "0-1,3", "--json"))
    assert done.exit_code == 0, done.output
    cards = json.loads(done.stdout)
    assert [card["training"]["seed"] for card in cards] == [0, 1, 3]
    assert sorted(folder.name for folder in out.iterdir()) == ["seed-0", "seed-1", "seed-3"]
    alone = CliRunner().invoke(cli, command(release, tmp_path / "alone", "--seed", "3", "--json"))
    assert json.loads(alone.stdout)["sha256"] == cards[2]["sha256"] != cards[0]["sha256"]


@pytest.mark.parametrize("seeds", ["2-0", "a", "1,1", "0-", "-1"])
def test_seeds_that_are_none_are_named(release: rema_data.Release, tmp_path: Path, seeds: str) -> None:
    done = CliRunner().invoke(cli, command(release, tmp_path / "out", f"--seeds={seeds}"))
    assert done.exit_code == 2 and "--seeds" in done.output and not (tmp_path / "out").exists()


def test_the_defaults_are_those_of_a_plan() -> None:
    """A network that a plan asks for and one that is trained by hand are the same training."""
    known = {one.name: one.default for one in (*fields(TrainingConfig), *fields(Architecture))}
    given = {one.name: one.default for one in train.params if isinstance(one.default, bool | int | float | str)}
    both = known.keys() & given.keys()
    assert {"updates", "batch_size", "learning_rate", "balance", "hard_every", "width", "scene_stride"} <= both
    assert {name: given[name] for name in both} == {name: known[name] for name in both}
