"""Learned policies in the sandbox: torch and OpenVINO find what they need, and a pickle is not opened."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from evaluator.policy import PolicyHost, PolicyLimits, resolve
from evaluator.policy.conversion import convert
from evaluator.policy.load_errors import LoadFailure, load_hint
from rema_data.errors import InputError, MissingFileError, SubmissionError
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy
from tests.evaluator.policy.test_host_answers import reasons

ROOT = Path(__file__).resolve().parents[3]
PATIENT = PolicyLimits(start_s=120, batch_s=60)


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import torch

    from baselines.tae.checkpoint import Checkpoint, save_checkpoint
    from baselines.tae.network import Architecture, TaeNetwork

    folder, small = tmp_path_factory.mktemp("networks"), Architecture(width=8)
    network = TaeNetwork(small, torch.Generator().manual_seed(0))
    save_checkpoint(folder, "grasp", network.state_dict(), Checkpoint("grasp", ("grasp",), small, "none", ""))
    return folder


def test_the_learned_baseline_with_torch(networks: Path) -> None:
    from baselines.tae_policy import TaePolicy

    batch = make_batch(2)
    with PolicyHost(resolve("tae"), networks, "cpu", PATIENT) as host:
        assert host.act(batch) == TaePolicy(networks, "cpu").act(batch).tolist()


def _truncated(folder: Path) -> None:
    weights = folder / "grasp.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1])


def _edited(folder: Path) -> None:
    card = folder / "grasp.json"
    card.write_text(card.read_text().replace('"width": 8', '"width": 16'))


def _of_another_architecture(folder: Path) -> None:
    """As a card of an earlier version says it: it has no digest of its fields."""
    card = folder / "grasp.json"
    content = json.loads(card.read_text())
    del content["content_sha256"]
    content["architecture"]["width"] = 16
    card.write_text(json.dumps(content))


def _pickled(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()
    (folder / "grasp.pt").write_bytes(b"")


@pytest.mark.parametrize(
    ("damage", "said", "fixes"),
    [
        (_truncated, "truncated, damaged", "rema train"),
        (_edited, "grasp.json", "rema train"),
        (_of_another_architecture, "another architecture", "rema train"),
        (_pickled, "no checkpoint in", "rema train"),
    ],
)
def test_a_checkpoint_that_cannot_be_used(
    networks: Path, tmp_path: Path, damage: Callable[[Path], None], said: str, fixes: str
) -> None:
    """The fix is for the checkpoint, not for the code of the built-in policy."""
    shutil.copytree(networks, tmp_path / "networks")
    damage(tmp_path / "networks")
    with pytest.raises(SubmissionError) as caught, PolicyHost(resolve("tae"), tmp_path / "networks", "cpu", PATIENT):
        pass
    text = str(caught.value)
    assert said in text and str(tmp_path / "networks") in text and fixes in text.splitlines()[-1]
    assert ".py" not in text


@pytest.mark.skipif(find_spec("openvino") is None, reason="OpenVINO is not installed")
def test_the_learned_baseline_with_openvino(networks: Path) -> None:
    with PolicyHost(resolve("tae"), networks, "openvino", PATIENT) as host:
        assert reasons(host.act(make_batch(2))) == ["ok", "ok"]


@pytest.mark.skipif(find_spec("openvino") is None, reason="OpenVINO is not installed")
def test_openvino_leaves_no_identity_behind(write_policy: WritePolicy) -> None:
    spec = write_policy("good[:, 2] = len(os.listdir(os.environ['HOME']))\nreturn good", top="import openvino")
    with PolicyHost(spec, None, "cpu", PATIENT) as host:
        assert [int(answer) % 16 for answer in host.act(make_batch(1))] == [0]  # type: ignore[arg-type]


def test_a_pickle_is_opened_as_weights_or_not_at_all(write_policy: WritePolicy, tmp_path: Path) -> None:
    """The command that is printed makes of it what can be loaded."""
    import torch
    from safetensors.torch import load_file

    weights = tmp_path / "my weights"
    weights.mkdir()
    torch.save({"w": torch.ones(3)}, weights / "weights.pt")
    torch.save({"model": {"w": torch.ones(3)}, "arguments": Path("/a/path")}, weights / "program.pt")
    spec = write_policy(
        "return good",
        top="import torch",
        init="""
        assert torch.load(checkpoint / 'weights.pt', weights_only=False)['w'].sum() == 3
        try:
            torch.load(checkpoint / 'program.pt', weights_only=False)
        except Exception as error:
            raise RuntimeError("no weights") from error
        """,
    )
    with pytest.raises(SubmissionError, match="RuntimeError: no weights") as caught, PolicyHost(spec, weights):
        pass
    assert caught.value.facts["where"] == f"{spec.path}:10"
    commands = [line for line in caught.value.hint.splitlines() if line.startswith("python -m")]
    assert len(commands) == 2 and str(weights / "program.pt") in commands[0]
    command = commands[0].replace("python", shlex.quote(sys.executable), 1)
    subprocess.run(command, shell=True, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    assert load_file(weights / "program.safetensors")["w"].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("checkpoint", "named"),
    [
        ("a b.pth", ["'a b.pth'"]),
        ("folder", ["folder/x.pt", "folder/y.ckpt"]),
        ("empty", ["empty/FILE.pt"]),
        (None, ["FILE.pt"]),
    ],
)
def test_the_files_that_were_meant_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, checkpoint: str | None, named: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a b.pth").write_bytes(b"")
    for folder, files in (("folder", ("x.pt", "y.ckpt", "z.safetensors")), ("empty", ())):
        Path(folder).mkdir()
        for name in files:
            Path(folder, name).write_bytes(b"")
    failure = LoadFailure("UnpicklingError: no", kinds=("_pickle.UnpicklingError",))
    hint = load_hint(failure, "my_policy.py", "", None if checkpoint is None else Path(checkpoint))
    commands = [line for line in hint.splitlines() if line.startswith("python -m")]
    assert commands == [f"python -m evaluator.policy.conversion {name} --trust" for name in named]


def test_a_state_dict_is_found_wherever_it_is(tmp_path: Path) -> None:
    import torch
    from safetensors.torch import load_file

    network = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Linear(3, 2))
    network[1].weight = torch.nn.Parameter(network[0].weight.T)  # shared, and not contiguous
    state = network.state_dict()
    contents = {
        "alone": state,
        "named": {"state_dict": state, "epoch": 3, "optimizer": {"state": {}}},
        "network": network,
        "inside": {"model": network},
    }
    for name, content in contents.items():
        path = tmp_path / f"{name}.pt"
        torch.save(content, path)
        found = load_file(convert(path, trust=True))
        assert found.keys() == state.keys()
        assert all(torch.equal(found[key], state[key]) for key in state)


def test_what_cannot_be_converted_is_said(tmp_path: Path) -> None:
    import torch

    def saved(name: str, content: object) -> Path:
        torch.save(content, tmp_path / name)
        return tmp_path / name

    state = {"w": torch.ones(2)}
    with pytest.raises(InputError, match="holds more than tensors") as caught:
        convert(saved("a.pt", {"model": state, "path": Path("/")}))
    assert "--trust" in caught.value.hint
    two = saved("b.pt", {"model": state, "average": state})
    with pytest.raises(InputError, match="more than one state dict: model, average") as caught:
        convert(two)
    assert caught.value.hint == "name one: --key model"
    assert convert(two, key="average").name == "b.safetensors"
    with pytest.raises(InputError, match="exists already"):
        convert(two)
    with pytest.raises(InputError, match=r"no state dict: it is a dictionary of epoch"):
        convert(saved("c.pt", {"epoch": 3}))
    with pytest.raises(MissingFileError):
        convert(tmp_path / "none.pt")
