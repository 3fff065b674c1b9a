"""Two processes under torch.distributed see one global batch, without being told their rank."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from rema_data.samplers import BalancedSampler
from tests.rema_data.samplers.tables import uneven

PROCESS = """
import json, sys
import torch.distributed
from rema_data.samplers import BalancedSampler
from tests.rema_data.samplers.tables import uneven

rank = int(sys.argv[2])
torch.distributed.init_process_group("gloo", init_method=f"file://{sys.argv[1]}/store", rank=rank, world_size=2)
sampler = BalancedSampler(uneven(), 4, num_samples=80)
batches = [batch.tolist() for _ in range(2) for batch in sampler]
gathered = [None, None]
torch.distributed.all_gather_object(gathered, batches)
torch.distributed.destroy_process_group()
if rank == 0:
    print(json.dumps(gathered))
"""


def test_two_processes_share_the_global_batch(tmp_path: Path) -> None:
    environment = {**os.environ, "GLOO_SOCKET_IFNAME": "lo"}
    ranks = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS, str(tmp_path), str(rank)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(2)
    ]
    (output, errors), (_, more) = (process.communicate(timeout=120) for process in ranks)
    assert [process.returncode for process in ranks] == [0, 0], errors + more
    first, second = json.loads(output)
    alone = BalancedSampler(uneven(), 8, num_samples=80)
    expected = [sorted(batch.tolist()) for _ in range(2) for batch in alone]
    assert [sorted(a + b) for a, b in zip(first, second, strict=True)] == expected
    assert all(len(a) == len(b) == 4 for a, b in zip(first, second, strict=True))
