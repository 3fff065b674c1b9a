"""Learned policies inside the walls: torch and OpenVINO find what they need, and a pickle is not opened."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from evaluator.policy import PolicyHost, PolicyLimits, resolve
from rema_data.errors import SubmissionError
from tests.evaluator.policy.batches import make_batch
from tests.evaluator.policy.conftest import WritePolicy
from tests.evaluator.policy.test_host_answers import reasons

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


@pytest.mark.skipif(find_spec("openvino") is None, reason="OpenVINO is not installed")
def test_the_learned_baseline_with_openvino(networks: Path) -> None:
    with PolicyHost(resolve("tae"), networks, "openvino", PATIENT) as host:
        assert reasons(host.act(make_batch(2))) == ["ok", "ok"]


def test_a_pickle_is_opened_as_weights_or_not_at_all(write_policy: WritePolicy, tmp_path: Path) -> None:
    import torch

    torch.save({"w": torch.ones(3)}, tmp_path / "weights.pt")
    torch.save({"w": Path("/a/path")}, tmp_path / "program.pt")
    spec = write_policy(
        "return good",
        top="import torch",
        init="assert torch.load(checkpoint / 'weights.pt', weights_only=False)['w'].sum() == 3\n"
        "torch.load(checkpoint / 'program.pt', weights_only=False)",
    )
    with pytest.raises(SubmissionError, match="UnpicklingError") as caught, PolicyHost(spec, tmp_path, "cpu", PATIENT):
        pass
    assert caught.value.facts["where"] == f"{spec.path}:7"
    assert "safetensors.torch" in caught.value.hint
