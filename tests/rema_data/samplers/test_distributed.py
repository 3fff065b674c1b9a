"""Two processes of ``torchrun`` see one global batch, without being told their rank: the recipe of docs/dataset.md."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import rema_data
from rema_data.samplers import BalancedSampler
from tests.rema_data.samplers.test_ranks import TORCHRUN

BEFORE = """
import json, torch, torch.distributed, rema_data
dataset = rema_data.load("rema-sample").steps(split="train")
try:
    rema_data.BalancedSampler(dataset, 4)
except rema_data.errors.InputError as error:
    refused = str(error)
"""
AFTER = """
assert refused.startswith("WORLD_SIZE is 2"), refused
batches = [batch.index.tolist() for _ in range(2) for batch in loader]
gathered = [None, None]
torch.distributed.all_gather_object(gathered, batches)
rank = torch.distributed.get_rank()
torch.distributed.destroy_process_group()
if rank == 0:
    print(json.dumps(gathered))
"""


def test_two_processes_share_the_global_batch(tmp_path: Path) -> None:
    (tmp_path / "train.py").write_text(BEFORE + TORCHRUN + AFTER)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    launched = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "GLOO_SOCKET_IFNAME": "lo"}
    root = str(Path(__file__).resolve().parents[3])
    ranks = [
        subprocess.Popen(
            [sys.executable, "train.py"],
            env={**os.environ, **launched, "RANK": str(rank), "PYTHONPATH": root},
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(2)
    ]
    (output, errors), (_, more) = (process.communicate(timeout=120) for process in ranks)
    assert [process.returncode for process in ranks] == [0, 0], errors + more
    first, second = json.loads(output)
    dataset = rema_data.load("rema-sample").steps(tasks=["grasp"], split="train")
    alone = BalancedSampler(dataset, 8, by=("success",), seed=0)
    expected = [sorted(batch) for _ in range(2) for batch in alone]
    assert [sorted(a + b) for a, b in zip(first, second, strict=True)] == expected
    assert all(len(a) == len(b) == 4 for a, b in zip(first, second, strict=True))
