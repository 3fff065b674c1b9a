"""What half precision costs, on a network without training: it runs, and it counts."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import torch

from baselines.tae.checkpoint import load_checkpoint, save_checkpoint
from baselines.tae.network import Architecture, TaeNetwork
from benchmarks import half_precision
from tests.baselines.tae.test_checkpoint import about


def test_weights_are_rounded_and_statistics_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    architecture = Architecture(width=4)
    network = TaeNetwork(architecture)
    next(layer for layer in network.modules() if isinstance(layer, torch.nn.BatchNorm2d)).running_var.fill_(1e6)
    save_checkpoint(tmp_path / "one", "push", network.state_dict(), about(primitive="push", architecture=architecture))
    before, after, beyond = half_precision.halved(tmp_path / "one", tmp_path / "two")
    assert before / 2 < after < before and beyond == 1
    rounded, _ = load_checkpoint(tmp_path / "two" / "push")
    for (key, value), weights in zip(rounded.state_dict().items(), network.state_dict().values(), strict=True):
        assert torch.equal(value, weights.half().float() if key in dict(network.named_parameters()) else weights), key

    words = ["half_precision.py", "--checkpoint", str(tmp_path / "one"), "--tasks", "push", "--scenarios", "2"]
    monkeypatch.setattr(sys, "argv", [*words, "--json", str(tmp_path / "result.json")])
    assert half_precision.main() == 0
    (row,) = json.loads((tmp_path / "result.json").read_text())["numbers"]["found"]
    assert row["of"] == 2 and row["lost"] + row["won"] <= row["others"]
