"""`rema publish`: networks that `rema evaluate tae --checkpoint` plays, and the verb for both kinds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
import yaml
from click.testing import CliRunner, Result

from baselines.publish.networks import publish_networks
from baselines.tae.checkpoint import Checkpoint, load_checkpoint, networks_in, save_checkpoint
from baselines.tae.network import Architecture, TaeNetwork
from evaluator.cli.main import cli
from evaluator.policy.shipped import shipped_checkpoint
from rema_data.errors import InputError, IntegrityError, MissingFileError, RemaError
from rema_data.testing import make_release


def publish(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["publish", *map(str, arguments)], prog_name="rema")


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """A folder of one network, as `rema train` writes it but for what it learned."""
    architecture = Architecture(width=8)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        weights = TaeNetwork(architecture).state_dict()
    about = Checkpoint("grasp", ("grasp",), architecture, "mine", "0" * 64)
    save_checkpoint(tmp_path / "mine", "grasp", weights, about)
    return tmp_path / "mine"


def test_the_networks_of_rema(tmp_path: Path) -> None:
    try:
        place = shipped_checkpoint("tae-joint")
    except RemaError:
        pytest.skip("the networks come with a clone only")
    assert place is not None
    done = publish("tae-joint", "--to", tmp_path / "joint", "--repo", "lab/joint")
    assert done.exit_code == 0, done.stderr
    assert f"hf upload lab/joint {tmp_path / 'joint'} . --repo-type model" in done.stdout
    for name, file in networks_in(place).items():
        assert (tmp_path / "joint" / f"{name}.safetensors").read_bytes() == file.read_bytes()
    card = (tmp_path / "joint" / "README.md").read_text()
    matter = yaml.safe_load(card.split("---\n", 2)[1])
    assert matter["license"] == "mit" and matter["pipeline_tag"] == "robotics"
    assert "rema evaluate tae --checkpoint" in card and "| grasp | grasp, grasp_grasp |" in card
    citation = yaml.safe_load((tmp_path / "joint" / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0" and citation["license"] == "MIT"


def test_networks_of_your_own(trained: Path, tmp_path: Path) -> None:
    done = publish(trained, "--to", tmp_path / "out", "--license", "Apache-2.0", "--json")
    assert done.exit_code == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["kind"], answer["path"]) == ("model", str(tmp_path / "out"))
    assert answer["files"] == len(list((tmp_path / "out").iterdir())) == 7
    _, about = load_checkpoint(networks_in(tmp_path / "out")["grasp"])
    assert about.release == "mine" and "Apache-2.0" in (tmp_path / "out" / "LICENSE").read_text()


@pytest.mark.slow
def test_the_folder_is_played(trained: Path, tmp_path: Path) -> None:
    publish_networks(str(trained), tmp_path / "out", "MIT")
    run = CliRunner().invoke(
        cli,
        [
            *f"evaluate tae --checkpoint {tmp_path}/out --task grasp --episodes 2 --engine inline --json".split(),
            "--output",
            str(tmp_path / "run"),
        ],
    )
    assert run.exit_code == 0, run.stderr
    assert json.loads(run.stdout)["episodes"] == 2


def test_a_licence_is_asked_for(trained: Path, tmp_path: Path) -> None:
    for licence in ("", "mine"):
        with pytest.raises(InputError, match="choose one of them with --license: CC-BY-4.0"):
            publish_networks(str(trained), tmp_path / "out", licence)
    assert not (tmp_path / "out").exists()


def test_damaged_weights_are_not_published(trained: Path, tmp_path: Path) -> None:
    path = trained / "grasp.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(IntegrityError, match="truncated, damaged or of another training"):
        publish_networks(str(trained), tmp_path / "out" / "new", "MIT")
    assert not (tmp_path / "out").exists()


def test_a_network_without_its_card(trained: Path, tmp_path: Path) -> None:
    (trained / "grasp.json").unlink()
    with pytest.raises(MissingFileError, match=f"does not exist: {trained / 'grasp.json'}"):
        publish_networks(str(trained), tmp_path / "out", "MIT")
    assert not (tmp_path / "out").exists()


def test_a_release(tmp_path: Path) -> None:
    release = make_release(tmp_path / "sealed", tasks=("push",), episodes=4)
    done = publish(release.path, "--to", tmp_path / "out", "--no-viewer")
    assert done.exit_code == 0, done.stderr
    assert "hf upload ORG/NAME" in done.stdout and "--repo-type dataset" in done.stdout
    again = publish(release.path, "--to", tmp_path / "out")
    assert again.exit_code == 2 and "is there already" in again.stderr
    wrong = publish(release.path, "--to", tmp_path / "other", "--license", "MIT")
    assert wrong.exit_code == 2 and "leave out --license" in wrong.stderr
    unknown = publish("nothing", "--to", tmp_path / "other")
    assert unknown.exit_code == 2 and "neither a published release nor a folder" in unknown.stderr
    assert not (tmp_path / "other").exists()
