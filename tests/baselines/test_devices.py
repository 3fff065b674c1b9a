"""Devices that are not there are refused by name, before anything is read or played."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from baselines import devices
from baselines.devices import LEARNED, training_device
from baselines.rounds.plan import load_plan
from baselines.tae.openvino import OPENVINO
from evaluator.cli.main import cli
from rema_data.errors import InputError

ROOT = Path(__file__).parents[2]
NOT_HERE = ["gpu", "openvino", "meta", "cpu:", *([] if torch.cuda.is_available() else ["cuda", "cuda:7"])]


def test_usable_devices() -> None:
    assert training_device("cpu") == torch.device("cpu")
    assert {"tae", "tae-joint", "tae-separate"} == LEARNED and devices._OPENVINO == OPENVINO


@pytest.mark.parametrize("name", NOT_HERE)
def test_devices_that_are_not_there(name: str) -> None:
    with pytest.raises(InputError, match=f"device '{name}'") as caught:
        training_device(name)
    assert "cpu" in caught.value.hint


@pytest.mark.parametrize("verb", ["train", "rounds"])
def test_nothing_is_done_for_a_device_that_is_not_there(verb: str, tmp_path: Path) -> None:
    output = tmp_path / "out"
    what = [str(ROOT / "examples" / "tiny.toml")]
    if verb == "train":
        what = ["--release", "nowhere", "--tasks", "grasp", "--primitive", "grasp"]
    done = CliRunner().invoke(cli, [verb, *what, "--output", str(output), "--device", "gpu"])
    assert done.exit_code == 2 and "device 'gpu'" in done.output and not output.exists()


def test_a_round_that_needs_openvino(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Said before round 1, although round 4 is the one."""
    monkeypatch.setattr(devices, "find_spec", lambda name: None)
    text = (ROOT / "examples" / "tiny.toml").read_text()
    asked = text.replace('"tiny-recursion/round-3" }', '"tiny-recursion/round-3", device = "openvino" }')
    (tmp_path / "plan.toml").write_text(asked)
    done = CliRunner().invoke(cli, ["rounds", str(tmp_path / "plan.toml"), "--output", str(tmp_path / "out")])
    assert done.exit_code == 2 and "rounds[4] is played on the device openvino" in done.output
    assert "rema[openvino]" in done.output and not (tmp_path / "out").exists()


def test_a_round_on_a_device_that_is_not_there(tmp_path: Path) -> None:
    text = (ROOT / "examples" / "tiny.toml").read_text()
    asked = text.replace('"tiny-recursion/round-3" }', '"tiny-recursion/round-3", device = "gpu" }')
    (tmp_path / "plan.toml").write_text(asked)
    done = CliRunner().invoke(cli, ["rounds", str(tmp_path / "plan.toml"), "--output", str(tmp_path / "out")])
    assert done.exit_code == 2 and "rounds[4] is played on the device gpu: " in done.output and "cpu" in done.output
    assert not (tmp_path / "out").exists()


def test_only_learned_policies_need_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "find_spec", lambda name: None)
    head = 'name = "a"\ntitle = "A"\ndescription = "A"\nlicense = "CC-BY-4.0"\ncitation = "A"\nseed = 1\n[[rounds]]\n'
    rest = 'episodes = { train = 1 }\ntasks = ["grasp"]\n'
    (tmp_path / "networks").mkdir()
    for code, refused in (("random", False), ("tae", True)):
        policy = f'policy = {{ code = "{code}", checkpoint = "networks", device = "openvino" }}\n'
        (tmp_path / "plan.toml").write_text(head + policy + rest)
        plan = load_plan(tmp_path / "plan.toml")
        if refused:
            with pytest.raises(InputError, match="OpenVINO is not installed"):
                plan.check_devices()
        else:
            plan.check_devices()
