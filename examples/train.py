"""Train the network of `torch_policy.py` on a release, and look at what it learned on the validation split.

python examples/train.py --output weights.safetensors                # rema-mini: well under a minute
python examples/train.py --release rema-sample --batches 300         # the sample that comes with the package
rema evaluate examples/torch_policy.py --checkpoint weights.safetensors --task grasp --episodes 200
"""

from __future__ import annotations

import argparse
import sys
from itertools import chain, islice, repeat
from pathlib import Path

import numpy as np
import torch
from patches import features, mirrored
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.utils.data import DataLoader
from torch_policy import Network

import rema_data
from rema_data import grid
from rema_data.errors import RemaError


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--release", default="rema-mini", help="name or folder")
    parser.add_argument("--batches", type=int, default=2000)
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path("weights.safetensors"))
    options = parser.parse_args()
    try:
        train(options)
    except RemaError as error:  # with the edit or the command that fixes it
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)


def train(options: argparse.Namespace) -> None:
    torch.manual_seed(options.seed)  # of the first weights; every later draw has a generator of its own
    random = np.random.default_rng(options.seed)
    release = rema_data.load(options.release)
    network = Network()
    for primitive in ("grasp", "push"):  # the tasks of one step are called by its primitive
        dataset = release.steps(tasks=[primitive], split="train")
        sampler = rema_data.BalancedSampler(dataset, options.batch_size, by=("success",), seed=options.seed)
        print(sampler.describe())
        epochs = chain.from_iterable(repeat(DataLoader(dataset, batch_sampler=sampler)))
        optimiser = torch.optim.AdamW(network.of[primitive].parameters(), weight_decay=0.1)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=2e-3, total_steps=options.batches)
        for done, batch in enumerate(islice(epochs, options.batches), start=1):
            seen = inputs(batch.float(), primitive, random)
            loss = nn.functional.binary_cross_entropy_with_logits(network(seen, primitive), batch.success.float())
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            if done % 500 == 0:
                print(f"{primitive}, batch {done:,}: loss {loss.item():.3f}")
        print(validate(network, release.steps(tasks=[primitive], split="val"), primitive))
    save_file(network.state_dict(), options.output)
    print(options.output)


def inputs(batch: rema_data.FloatBatch, primitive: str, random: np.random.Generator | None = None) -> Tensor:
    """Features of the recorded actions; with `random` half of them mirrored, and half of the hands turned round."""
    i, j, k = grid.decode(batch.action.numpy())
    if random is not None:
        k = k + 8 * random.integers(2, size=len(k))
    seen = features(batch.scene[:, 0].numpy(), i, j, k, primitive)
    if random is not None:
        seen = np.where(random.random((len(seen), 1)) < 0.5, mirrored(seen), seen)
    return torch.from_numpy(seen)


@torch.inference_mode()
def validate(network: Network, dataset: rema_data.StepDataset, primitive: str) -> str:
    """How well logits tell successes from failures: the share of pairs that are in the right order."""
    batch = dataset[range(len(dataset))].float()
    logit = network(inputs(batch, primitive), primitive)
    wins, losses = logit[batch.success], logit[~batch.success]
    auc = (wins[:, None] > losses[None]).float().mean()
    return f"{primitive}, validation: AUC {auc:.3f} over {len(wins)} successes and {len(losses)} failures"


if __name__ == "__main__":
    main()
