"""Trainings: the same weights through any interruption, and clear ends of the bad ones."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

import rema_data
from baselines.tae.checkpoint import load_checkpoint, networks_in
from baselines.train import loop
from baselines.train.config import TrainingConfig
from baselines.train.data import open_data
from baselines.train.loop import DivergedError, train, trained
from rema_data.errors import InputError, IntegrityError, MissingFileError, RunMismatchError
from rema_data.progress import Silent
from rema_data.validation import plain
from tests.baselines.train.conftest import tree

ROOT = Path(__file__).parents[3]


class Interruption(Exception):
    """As if the process had been killed after an update."""


class Told(Silent):
    """Progress that keeps the notes, and calls a function after every update."""

    def __init__(self, then: Callable[[int], None] = lambda update: None) -> None:
        self.update, self.then = 0, then
        self.notes: list[str] = []

    def advance(self, n: int) -> None:
        self.update += n
        self.then(self.update)

    def resume(self, n: int) -> None:
        self.update = n

    def note(self, text: str) -> None:
        self.notes.append(text)


def interrupted_at(update: int) -> Told:
    def then(now: int) -> None:
        if now == update:
            raise Interruption

    return Told(then)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every frozen list is read once for the module (``undisturbed``), not by each training: see ``test_data``."""
    monkeypatch.setattr("baselines.train.data.refuse_test_scenes", lambda *_: None)


@pytest.fixture(scope="module")
def undisturbed(release: rema_data.Release, config: TrainingConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    train(release, config, folder, "grasp", deterministic=True)
    return folder


def test_a_training_leaves_a_network_with_its_card(
    release: rema_data.Release, config: TrainingConfig, undisturbed: Path
) -> None:
    network, about = load_checkpoint(undisturbed / "grasp")
    assert about.release == release.name and about.release_sha256 == release.fingerprint
    assert (about.primitive, about.skills, about.training) == ("grasp", ("grasp",), plain(config))
    assert about.updates in (3, 6, 9) and 0 <= about.metrics["auc"] <= 1 and network.architecture == config.architecture
    lines = [json.loads(line) for line in (undisturbed / "grasp.metrics.jsonl").read_text().splitlines()]
    assert [line["update"] for line in lines] == [3, 6, 9]
    assert about.metrics["auc"] == max(line["auc"] for line in lines)
    assert sorted(path.name for path in undisturbed.iterdir()) == [
        "grasp.json",
        "grasp.metrics.jsonl",
        "grasp.safetensors",
    ]


@pytest.mark.parametrize("at", [2, 3, 5, 7])
def test_interrupted_and_resumed_to_the_same_weights(
    release: rema_data.Release, config: TrainingConfig, undisturbed: Path, tmp_path: Path, at: int
) -> None:
    with pytest.raises(Interruption):
        train(release, config, tmp_path, "grasp", progress=interrupted_at(at), save_every=2)
    assert not (tmp_path / "grasp.json").exists()
    done = train(release, config, tmp_path, "grasp", deterministic=True, save_every=2)
    assert not done.already and tree(tmp_path) == tree(undisturbed)


@pytest.mark.parametrize("damage", ["weights", "card"])
def test_a_damaged_state_is_not_trusted(
    release: rema_data.Release, config: TrainingConfig, undisturbed: Path, tmp_path: Path, damage: str
) -> None:
    with pytest.raises(Interruption):
        train(release, config, tmp_path, "grasp", progress=interrupted_at(5))
    (state,) = (tmp_path / ".grasp.training").glob("*.safetensors")
    if damage == "weights":
        state.write_bytes(state.read_bytes()[:-1])
    else:
        state.with_suffix(".json").write_text("{}")
    train(release, config, tmp_path, "grasp")
    assert tree(tmp_path) == tree(undisturbed)


def test_a_finished_training_is_not_repeated(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path
) -> None:
    assert trained(release, config, tmp_path, "grasp") is None
    first = train(release, config, tmp_path, "grasp")
    again = train(release, config, tmp_path, "grasp", progress=interrupted_at(1))
    assert (first.already, again.already) == (False, True) and again.checkpoint == first.checkpoint
    other = dataclasses.replace(config, seed=1)
    with pytest.raises(RunMismatchError, match="another training"):
        train(release, other, tmp_path, "grasp")
    (tmp_path / "grasp.json").write_text("{")
    with pytest.raises(IntegrityError, match="is not JSON") as caught:
        train(release, config, tmp_path, "grasp")
    assert caught.value.hint.startswith(f"delete it to train it again: rm -f {tmp_path / 'grasp.json'}")


@pytest.mark.parametrize(("losses", "best"), [((0.3, 0.1, 0.2), 6), ((0.1, 0.2, 0.3), 3)])
def test_between_weights_of_equal_auc_the_loss_decides(
    release: rema_data.Release,
    config: TrainingConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    losses: tuple[float, ...],
    best: int,
) -> None:
    found = iter(losses)
    other = {"balanced_accuracy": 1.0, "calibration_error": 0.0, "skills": {}}
    monkeypatch.setattr(loop, "validate", lambda *_: {"auc": 1.0, "loss": next(found), **other})
    assert train(release, config, tmp_path, "grasp").checkpoint.updates == best


def test_the_card_has_the_skills_of_the_data(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not those that were asked for, and of which no episode reached the step."""
    asked = dataclasses.replace(config, tasks=("grasp", "grasp_push", "grasp_grasp"), on_empty="renormalise")
    monkeypatch.setattr(loop, "open_data", lambda release, _: open_data(release, config))
    assert asked.learned_skills == ("grasp", "grasp_grasp")
    assert train(release, asked, tmp_path, "grasp").checkpoint.skills == ("grasp",)


def test_other_code_does_not_resume_a_training(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(Interruption):
        train(release, config, tmp_path, "grasp", progress=interrupted_at(5))
    monkeypatch.setattr(loop, "source_digest", lambda package: "0" * 64)
    with pytest.raises(RunMismatchError, match="code differ"):
        train(release, config, tmp_path, "grasp")


def test_a_state_of_another_training_is_refused(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path
) -> None:
    with pytest.raises(Interruption):
        train(release, config, tmp_path, "grasp", progress=interrupted_at(4))
    with pytest.raises(RunMismatchError, match="training differ"):
        train(release, dataclasses.replace(config, learning_rate=1e-3), tmp_path, "grasp")


@pytest.mark.parametrize(("at", "kept"), [(2, False), (5, True)])
def test_a_loss_that_is_not_finite(
    release: rema_data.Release,
    config: TrainingConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    at: int,
    kept: bool,
) -> None:
    calls = iter(range(1, 100))
    real = loop.pixel_logits

    def poisoned(logits: torch.Tensor, pixel: torch.Tensor) -> torch.Tensor:
        return real(logits, pixel) * (float("nan") if next(calls) == at else 1.0)

    monkeypatch.setattr(loop, "pixel_logits", poisoned)
    with pytest.raises(DivergedError, match=f"update {at} is not a number") as caught:
        train(release, config, tmp_path, "grasp")
    assert "learning rate" in caught.value.hint and str(tmp_path / ".grasp.training") in caught.value.hint
    assert not (tmp_path / "grasp.json").exists() and trained(release, config, tmp_path, "grasp") is None
    if kept:
        assert str(tmp_path / "diverged" / "grasp") in caught.value.message
        assert load_checkpoint(tmp_path / "diverged" / "grasp")[1].updates == 3
        with pytest.raises(MissingFileError):
            networks_in(tmp_path)
    else:
        assert "no weights were good enough" in caught.value.message and not (tmp_path / "diverged").exists()
    done = train(release, config, tmp_path, "grasp")  # without the poison, from the last state
    assert not done.already and set(networks_in(tmp_path)) == {"grasp"}


@pytest.mark.parametrize(
    ("part", "words"), [("weight", "left weights that are"), ("answers", "validation steps are not")]
)
def test_finite_losses_of_a_network_that_is_not_finite(
    release: rema_data.Release,
    config: TrainingConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    part: str,
    words: str,
) -> None:
    """The last step of the optimiser breaks the network, or its answers overflow: no loss has said so."""
    config = dataclasses.replace(config, validation_steps=4)
    real = loop._Training.step

    def breaking(self: Any, samples: Any) -> torch.Tensor:
        loss = real(self, samples)
        if self.update == 5:  # before the sixth, which is validated
            with torch.no_grad():
                for layer in self.network.decoder.parameters():
                    layer *= float("nan") if part == "weight" else 1e20
        return loss

    monkeypatch.setattr(loop._Training, "step", breaking)
    with pytest.raises(DivergedError, match=words) as caught:
        train(release, config, tmp_path, "grasp")
    assert caught.value.facts["update"] == 6 and "update 6" in caught.value.message
    assert load_checkpoint(tmp_path / "diverged" / "grasp")[1].updates == 3
    assert trained(release, config, tmp_path, "grasp") is None
    (state,) = (tmp_path / ".grasp.training").glob("state-*.json")
    assert state.stem == "state-00000003"  # nothing that is broken was saved


def test_threads_are_in_the_card(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another number of them gives other sums: a training goes on, and says so."""
    monkeypatch.setattr(loop.torch, "get_num_threads", lambda: 1)
    with pytest.raises(Interruption):
        train(release, config, tmp_path, "grasp", progress=interrupted_at(2), save_every=1)
    monkeypatch.setattr(loop.torch, "get_num_threads", lambda: 3)
    told = Told()
    train(release, config, tmp_path, "grasp", progress=told)
    assert "resumed after update 1 of 9; with 1 and 3 threads" in told.notes[0]
    assert load_checkpoint(tmp_path / "grasp")[1].metrics["threads"] == [1, 3]


def test_two_trainings_of_one_name(release: rema_data.Release, config: TrainingConfig, tmp_path: Path) -> None:
    """The message names the first process, which goes on undisturbed."""

    def begun_again(update: int) -> None:
        if update == 4:
            with pytest.raises(InputError, match=f"process {os.getpid()} on .* is working on this training") as caught:
                train(release, config, tmp_path, "grasp")
            assert str(tmp_path / ".grasp.training") in caught.value.message and "wait" in caught.value.hint

    assert not train(release, config, tmp_path, "grasp", progress=Told(begun_again)).already
    assert not (tmp_path / ".grasp.training").exists()


def test_state_left_by_a_kill_after_the_end_is_removed(
    release: rema_data.Release, config: TrainingConfig, undisturbed: Path, tmp_path: Path
) -> None:
    shutil.copytree(undisturbed, tmp_path / "out")
    (tmp_path / "out" / ".grasp.training").mkdir()
    (tmp_path / "out" / ".grasp.training" / "state-00000009.json").write_text("{}")
    found = trained(release, config, tmp_path / "out", "grasp")
    assert found is not None and found.already and not (tmp_path / "out" / ".grasp.training").exists()


def test_one_seed_one_network(release: rema_data.Release, config: TrainingConfig, tmp_path: Path) -> None:
    digests = []
    for name, seed in (("one", 0), ("two", 0), ("other", 7)):
        done = train(release, dataclasses.replace(config, seed=seed, updates=3), tmp_path, name)
        digests.append(done.checkpoint.sha256)
    assert digests[0] == digests[1] != digests[2]


def test_training_leaves_the_global_generator_alone(
    release: rema_data.Release, config: TrainingConfig, tmp_path: Path
) -> None:
    before = torch.random.get_rng_state()
    train(release, dataclasses.replace(config, updates=2), tmp_path, "grasp")
    assert torch.equal(torch.random.get_rng_state(), before)


COMMAND = """
import sys, time
from pathlib import Path
import rema_data
import rema_data.release.folder
from baselines.train import loop
from baselines.train.config import TrainingConfig
from baselines.tae.network import Architecture
from rema_data.progress import Silent
release = rema_data.Release(rema_data.release.folder.find_release(Path(sys.argv[1])), cache=Path(sys.argv[2]))
small = Architecture(width=4)
config = TrainingConfig("grasp", ("grasp", "grasp_push"), updates=9, validate_every=3, architecture=small)
class Slow(Silent):
    def advance(self, n):
        time.sleep(float(sys.argv[4]))
loop.train(release, config, Path(sys.argv[3]), "grasp", save_every=1, progress=Slow())
"""


def test_killed_and_run_again(release: rema_data.Release, undisturbed: Path, tmp_path: Path) -> None:
    """kill -9 in the middle, as a cluster would do it."""

    def start(pause: float) -> subprocess.Popen[bytes]:
        words = [str(release.folder.path), str(tmp_path / "cache"), str(tmp_path / "out"), str(pause)]
        return subprocess.Popen([sys.executable, "-c", COMMAND, *words], cwd=ROOT, env=os.environ)

    running = start(0.1)
    deadline = time.monotonic() + 90
    while not any(int(path.stem[-8:]) >= 2 for path in (tmp_path / "out").glob(".grasp.training/state-*.json")):
        assert time.monotonic() < deadline and running.poll() is None
        time.sleep(0.01)
    running.send_signal(signal.SIGKILL)
    running.wait()
    assert start(0.0).wait(120) == 0
    assert tree(tmp_path / "out") == tree(undisturbed)
