"""The networks of the built-in policies: found, checked, and asked for by name where they are missing."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from evaluator.policy.shipped import publish_checkpoint, shipped_checkpoint, shipped_policies
from rema_data.errors import IntegrityError, MissingFileError

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
    assert set(shipped_policies()["tae-joint"][1]) == {"grasp.safetensors", "grasp.json"}
    assert shipped_checkpoint("random") is None and shipped_checkpoint("tae") is None


def test_another_policy_is_entered_beside_it(networks: Path) -> None:
    before = shipped_policies()["tae-joint"]
    publish_checkpoint("tae-separate", "mine/separate", networks)
    assert shipped_policies() == {"tae-joint": before, "tae-separate": ("mine/separate", before[1])}


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


@pytest.mark.parametrize("content", ["{", '{"policies": {"tae-joint": {}}}', "[]", LONG])
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


@pytest.mark.parametrize(("policy", "task"), [("tae-joint", "grasp_push"), ("tae-separate", "push")])
def test_the_published_networks_play(policy: str, task: str, tmp_path: Path) -> None:
    """With a name alone, as the README has it; the evaluator never has torch or the network in its process."""
    command = [sys.executable, "-c", EVALUATOR, "evaluate", policy, "--task", task, "--json"]
    command += ["--episodes", "4", "--workers", "1", "--output", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["episodes"] == 4 and summary["policy_errors"] == 0 and summary["successes"] > 0
