"""Checkpoints: kept to the bit, and refused by name when they are anything else."""

from __future__ import annotations

import dataclasses
import json
import pickle
from pathlib import Path

import pytest
import torch

from baselines.tae.checkpoint import Checkpoint, load_checkpoint, networks_in, save_checkpoint
from baselines.tae.network import Architecture, TaeNetwork
from rema_data.errors import InputError, IntegrityError, MissingFileError

SMALL = Architecture(width=8)


def about(**changes: object) -> Checkpoint:
    made = Checkpoint("grasp", ("grasp",), SMALL, "tiny", "0" * 64, {"seed": 0}, {"auc": 0.5}, 10)
    return dataclasses.replace(made, **changes)  # type: ignore[arg-type]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    network = TaeNetwork(SMALL, torch.Generator().manual_seed(0))
    save_checkpoint(tmp_path, "grasp", network.state_dict(), about())
    return tmp_path / "grasp.safetensors"


def test_weights_and_card_come_back(saved: Path) -> None:
    network, card = load_checkpoint(saved)
    wanted = TaeNetwork(SMALL, torch.Generator().manual_seed(0)).state_dict()
    assert all(torch.equal(wanted[name], tensor) for name, tensor in network.state_dict().items())
    assert not network.training and dataclasses.replace(card, sha256="") == about()
    assert networks_in(saved.parent) == {"grasp": saved} == networks_in(saved)
    assert sorted(path.name for path in saved.parent.iterdir()) == ["grasp.json", "grasp.safetensors"]


def test_half_precision_costs_little(tmp_path: Path) -> None:
    network = TaeNetwork(SMALL, torch.Generator().manual_seed(0))
    save_checkpoint(tmp_path, "half", network.state_dict(), about(dtype="float16"))
    back, _ = load_checkpoint(tmp_path / "half")
    for name, tensor in back.state_dict().items():
        assert tensor.dtype == network.state_dict()[name].dtype
        torch.testing.assert_close(tensor, network.state_dict()[name], atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("keep", [0, 100, -1])
def test_truncated_weights(saved: Path, keep: int) -> None:
    saved.write_bytes(saved.read_bytes()[:keep])
    with pytest.raises(IntegrityError, match=r"grasp\.safetensors is truncated, damaged"):
        load_checkpoint(saved)


def test_a_flipped_byte(saved: Path) -> None:
    data = bytearray(saved.read_bytes())
    data[-7] ^= 1
    saved.write_bytes(data)
    with pytest.raises(IntegrityError) as caught:
        load_checkpoint(saved)
    assert "rema train" in caught.value.hint


@pytest.mark.parametrize("suffix", [".pt", ".pth", ".ckpt", ".pkl"])
def test_a_pickle_is_never_opened(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"grasp{suffix}"
    path.write_bytes(pickle.dumps({"weights": 1}))
    with pytest.raises(InputError, match="pickle") as caught:
        load_checkpoint(path)
    assert f"evaluator.policy.conversion {path}" in caught.value.hint


def test_a_pickle_under_another_name(saved: Path) -> None:
    saved.write_bytes(pickle.dumps({"weights": 1}))
    with pytest.raises(IntegrityError):
        load_checkpoint(saved)


def test_weights_of_another_architecture(saved: Path) -> None:
    card = saved.with_suffix(".json")
    content = json.loads(card.read_text())
    del content["content_sha256"]  # as in the cards of earlier versions
    content["architecture"]["width"] = 16
    card.write_text(json.dumps(content))
    with pytest.raises(InputError, match="another architecture"):
        load_checkpoint(saved)


def unsigned(card: Path) -> str:
    """A card without the sha256 of its content, as earlier versions wrote it."""
    content = json.loads(card.read_text())
    del content["content_sha256"]
    return json.dumps(content, indent=1)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda card: card.unlink(), MissingFileError),
        (lambda card: card.write_text("{"), IntegrityError),
        (lambda card: card.write_text('{"format": "other"}'), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"width"', '"depth"')), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"updates"', '"steps"')), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"width": 8', '"width": 100000')), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"updates": 10', '"updates": "10"')), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"width": 8', '"width": 4')), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"width": 8', '"width": 12')), InputError),
        (lambda card: card.write_text(unsigned(card).replace('"width": 8', '"width": 64')), InputError),
        (lambda card: card.write_text(card.read_text().replace("0.5", "0.75")), IntegrityError),
        (lambda card: card.write_text("[" * 100_000), IntegrityError),
        (lambda card: card.with_suffix(".safetensors").unlink(), MissingFileError),
    ],
)
def test_a_card_that_cannot_be_used(saved: Path, change: object, kind: type[Exception]) -> None:
    change(saved.with_suffix(".json"))  # type: ignore[operator]
    with pytest.raises(kind) as caught:
        load_checkpoint(saved)
    assert str(saved.parent) in str(caught.value)


def test_a_missing_network(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no checkpoint"):
        networks_in(tmp_path)
