"""The networks of the built-in policies: found, checked, and asked for by name where they are missing."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from evaluator.policy.loading import PolicySpec, weights_of
from evaluator.policy.named import NamedPolicy
from evaluator.policy.sandbox.snapshot import digest
from evaluator.policy.shipped import Shipped, publish_checkpoint, shipped_checkpoint, shipped_policies
from rema_data.errors import InputError, IntegrityError, MissingFileError
from rema_data.schema import TASKS

EVALUATOR = """
import sys
from evaluator.cli.main import cli
cli(standalone_mode=False)
code = set(sys.modules) - {"baselines", "baselines.catalogue"}
bad = {name.partition(".")[0] for name in code} & {"torch", "safetensors", "baselines", "openvino"}
sys.exit(str(sorted(bad)) if bad else 0)
"""


@pytest.fixture
def networks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of networks in a working folder with releases, published as those of tae-joint."""
    (tmp_path / "manifests").mkdir()
    monkeypatch.setenv("REMA_MANIFESTS", str(tmp_path / "manifests"))
    monkeypatch.setenv("REMA_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "releases" / "checkpoints" / "mine" / "joint"
    folder.mkdir(parents=True)
    for name in ("grasp.safetensors", "grasp.json", "grasp.metrics.jsonl"):
        (folder / name).write_text(name)
    publish_checkpoint("tae-joint", "mine/joint", folder)
    return folder


def test_found_and_checked(networks: Path) -> None:
    assert shipped_checkpoint("tae-joint") == networks
    assert set(shipped_policies()["tae-joint"].files) == {"grasp.safetensors", "grasp.json"}
    assert shipped_checkpoint("random") is None and shipped_checkpoint("tae") is None


def test_another_policy_is_entered_beside_it(networks: Path) -> None:
    before = shipped_policies()["tae-joint"]
    publish_checkpoint("tae-separate", "mine/separate", networks)
    assert shipped_policies() == {"tae-joint": before, "tae-separate": Shipped("mine/separate", before.files)}


@pytest.fixture
def tool2(networks: Path) -> Path:
    """Other networks of tae-joint, for the fifth task alone."""
    folder = networks.parents[1] / "tool2" / "joint"
    shutil.copytree(networks, folder)
    (folder / "grasp.safetensors").write_text("of more data")
    publish_checkpoint("tae-joint", "tool2/joint", folder, "grasp_grasp_push")
    return folder


def test_a_task_with_networks_of_its_own(networks: Path, tool2: Path) -> None:
    """The other tasks are played as before: their networks, and so the digest of their rows, stay."""
    spec = PolicySpec("tae-joint", Path(__file__), "Policy", NamedPolicy(Path(__file__), "Policy", "learned", "Fake."))
    played = {task: weights_of(spec, None, task) for task in (None, *TASKS)}
    assert played == {**dict.fromkeys((None, *TASKS), networks), "grasp_grasp_push": tool2}
    assert digest(spec, played["grasp_grasp_push"]) != digest(spec, played["push"]) == digest(spec, networks)
    assert weights_of(spec, networks, "grasp_grasp_push") == networks  # what a user names comes first
    (tool2 / "grasp.safetensors").write_text("changed")
    assert shipped_checkpoint("tae-joint", "push") == networks
    with pytest.raises(IntegrityError, match="not the published one"):
        shipped_checkpoint("tae-joint", "grasp_grasp_push")
    (tool2 / "grasp.json").unlink()
    with pytest.raises(MissingFileError, match=r"tae-joint \(tool2/joint\)"):
        shipped_checkpoint("tae-joint", "grasp_grasp_push")


def test_networks_of_a_task_stay_when_the_others_are_registered_again(networks: Path, tool2: Path) -> None:
    own = shipped_policies()["tae-joint"].tasks
    (networks / "grasp.safetensors").write_text("trained again")
    publish_checkpoint("tae-joint", "mine/joint", networks)
    assert shipped_policies()["tae-joint"].tasks == own and shipped_checkpoint("tae-joint") == networks
    with pytest.raises(InputError, match="tae-separate has no networks for other tasks than push"):
        publish_checkpoint("tae-separate", "mine/joint", networks, "push")
    assert set(shipped_policies()) == {"tae-joint"}


def test_the_plain_manifest_stays_as_it_was(networks: Path, tmp_path: Path) -> None:
    """Without networks of single tasks it has no word of them: earlier versions read it."""
    (entry,) = json.loads((tmp_path / "manifests" / "checkpoints.json").read_text())["policies"].values()
    assert set(entry) == {"folder", "files"}


def test_a_changed_file(networks: Path) -> None:
    (networks / "grasp.safetensors").write_text("other")
    with pytest.raises(IntegrityError, match=r"grasp\.safetensors is not the published one") as caught:
        shipped_checkpoint("tae-joint")
    assert "git checkout" in caught.value.hint and str(networks) in caught.value.hint


@pytest.mark.parametrize("name", ["push.safetensors", "push.json"])
def test_a_file_too_many(networks: Path, name: str) -> None:
    """A policy loads every network of its folder: an unpublished one would be used, too."""
    (networks / "grasp.png").write_text("no network")
    assert shipped_checkpoint("tae-joint") == networks
    (networks / name).write_text("mine")
    with pytest.raises(IntegrityError, match=f"{name} is not one of the published networks") as caught:
        shipped_checkpoint("tae-joint")
    assert "--checkpoint" in caught.value.hint and str(networks / name) in caught.value.hint


def test_what_is_stale_does_not_hide_what_is_good(networks: Path, tmp_path: Path) -> None:
    """An older download comes first, and is passed over."""
    stale = tmp_path / "home" / "releases" / "checkpoints" / "mine" / "joint"
    shutil.copytree(networks, stale)
    assert shipped_checkpoint("tae-joint") == stale
    (stale / "grasp.safetensors").write_text("of an older version")
    assert shipped_checkpoint("tae-joint") == networks
    (networks / "grasp.safetensors").write_text("damaged")
    with pytest.raises(IntegrityError) as caught:
        shipped_checkpoint("tae-joint")
    assert str(stale) in caught.value.hint  # the first of both


def test_a_missing_file(networks: Path) -> None:
    (networks / "grasp.json").unlink()
    with pytest.raises(MissingFileError, match="tae-joint") as caught:
        shipped_checkpoint("tae-joint")
    assert "--checkpoint" in caught.value.hint


LONG = json.dumps({"policies": {"tae-joint": {"folder": 300 * "x", "files": {}}}})


JUGGLE = json.dumps({"policies": {"tae-joint": {"folder": "x", "files": {}, "tasks": {"juggle": {}}}}})


@pytest.mark.parametrize("content", ["{", '{"policies": {"tae-joint": {}}}', "[]", LONG, JUGGLE])
def test_a_damaged_manifest(networks: Path, tmp_path: Path, content: str) -> None:
    (tmp_path / "manifests" / "checkpoints.json").write_text(content)
    with pytest.raises(IntegrityError, match="cannot be read"):
        shipped_policies()


def test_no_manifest_no_networks(networks: Path, tmp_path: Path) -> None:
    (tmp_path / "manifests" / "checkpoints.json").unlink()
    assert shipped_checkpoint("tae-joint") is None


def test_the_published_networks_are_whole() -> None:
    """What this repository names is in it, to the byte."""
    assert shipped_policies().keys() == {"tae-joint", "tae-separate"}
    for policy in shipped_policies():
        folder = shipped_checkpoint(policy)
        assert folder is not None
        for card in folder.glob("*.json"):
            assert json.loads(card.read_text())["format"].startswith("rema tae checkpoint")


@pytest.mark.parametrize(("policy", "task"), [("tae-joint", "grasp_grasp_push"), ("tae-separate", "push")])
def test_the_published_networks_play(policy: str, task: str, tmp_path: Path) -> None:
    """With a name alone, as the README has it; the evaluator never has torch or the network in its process."""
    command = [sys.executable, "-c", EVALUATOR, "evaluate", policy, "--task", task, "--json"]
    command += ["--episodes", "8", "--workers", "1", "--output", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["episodes"] == 8 and summary["policy_errors"] == 0 and summary["successes"] > 0
