"""Train the network of `torch_policy.py` on a release, and look at what it learned on the validation split.

    python examples/train.py --output weights.safetensors          # about three minutes on one core
    python examples/train.py --release rema-v0 --batches 3000      # more data, longer

"""

from __future__ import annotations

import argparse
import sys
from itertools import chain, islice, repeat
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch.nn.functional import binary_cross_entropy_with_logits
from torch.utils.data import DataLoader

import rema_data
from rema_data.augment import Augment
from rema_data.errors import RemaError
from torch_policy import PRIMITIVES, YAWS, Network


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--release", default="rema-mini", help="name or folder")
    parser.add_argument("--batches", type=int, default=1500)
    parser.add_argument("--batch-size", type=int, default=32)
    parser.add_argument("--output", type=Path, default=Path("weights.safetensors"))
    options = parser.parse_args()
    try:
        train(options)
    except RemaError as error:  # with the edit or the command that mends it
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)


def train(options: argparse.Namespace) -> None:
    release = rema_data.load(options.release)
    dataset = release.steps(tasks=PRIMITIVES, split="train")
    sampler = rema_data.BalancedSampler(dataset, batch_size=options.batch_size, by=("task", "success"), seed=0)
    loader = DataLoader(dataset, batch_sampler=sampler)
    print(sampler.describe())

    torch.manual_seed(0)
    network = Network()
    augment, random = Augment(dataset), torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=2e-3, total_steps=options.batches)
    batches = islice(chain.from_iterable(repeat(loader)), options.batches)
    mean = 0.0
    for done, batch in enumerate(batches, start=1):
        batch = augment(batch, random).float()
        loss = binary_cross_entropy_with_logits(logits(network, dataset, batch), batch.success.float())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        mean += loss.item()
        if done % 100 == 0:
            print(f"batch {done}: loss {mean/100:.3f}", flush=True)
            mean = 0.0
    save_file(network.state_dict(), options.output)

    for task in PRIMITIVES:
        val = release.steps(tasks=[task], split="val")
        batch = val[range(len(val))].float()
        with torch.inference_mode():
            score = logits(network, val, batch)
        wins, losses = score[batch.success], score[~batch.success]
        auc = (wins[:, None] > losses[None]).float().mean()
        print(f"{release.name}, {task}, validation: AUC {auc:.3f} over {len(wins)} successes and {len(losses)} failures")


def logits(network, dataset, batch):
    primitive = torch.from_numpy(np.array([PRIMITIVES.index(t) for t in dataset.table["task"].iloc[batch.index.numpy()]]))
    cell = batch.action // 16
    k = batch.action % YAWS
    return network(batch.scene)[torch.arange(len(cell)), primitive, cell // 64, cell % 64, k]


if __name__ == "__main__":
    main()
