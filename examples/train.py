"""Train a small map of success on a release, and look at what it learned on the validation split.

    python examples/train.py                       # the newest release on this machine; before any download, the sample
    python examples/train.py --release rema-mini --batches 2000

It learns where a bare gripper grasps: a plain convolutional network from the scene to one logit for every place and
angle. The paper's network, which sees the end effector too, is another and larger thing.
"""

from __future__ import annotations

import argparse
import sys

import torch
from torch import nn

import rema_data
from rema_data.augment import translate
from rema_data.errors import RemaError
from rema_data.grid import ANGLES


def network() -> nn.Module:
    """Scene float32 (N, 1, 64, 64) to logits (N, 16, 64, 64): one for every action (angle, row, column)."""
    layers: list[nn.Module] = [nn.Conv2d(1, 32, 3, padding=1), nn.ReLU()]
    for dilation in (2, 4, 8, 1):
        layers += [nn.Conv2d(32, 32, 3, padding=dilation, dilation=dilation), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(32, ANGLES, 1))


def logits_of_actions(model: nn.Module, scene: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    """Logit (N,) of the action that was taken: the only pixel that has a label."""
    maps = model(scene).permute(0, 2, 3, 1).flatten(1)  # grid index = (i * 64 + j) * 16 + k
    return maps.gather(1, action[:, None])[:, 0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--release", help="name or folder; the newest one on this machine by default")
    parser.add_argument("--batches", type=int, default=200)
    parser.add_argument("--batch-size", type=int, default=32)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    try:
        train(options)
    except RemaError as error:  # with the edit or the command that mends it
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)


def train(options: argparse.Namespace) -> None:
    release = rema_data.load(options.release)
    dataset = release.steps(tasks=["grasp"], split="train")
    sampler = rema_data.BalancedSampler(dataset, batch_size=options.batch_size, by=("success",), seed=0)
    loader = torch.utils.data.DataLoader(dataset, batch_sampler=sampler, num_workers=options.workers)
    print(sampler.describe())

    random = torch.Generator().manual_seed(0)  # every draw has a generator of its own: nothing global is touched
    model = network()
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-3)
    done = 0
    while done < options.batches:
        for batch in loader:
            scene, action = translate(batch.scene, batch.action, random)
            maps = batch.replace(scene=scene, action=action).float()
            logits = logits_of_actions(model, maps.scene, maps.action)
            loss = nn.functional.binary_cross_entropy_with_logits(logits, maps.success.float())
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            done += 1
            if done % 50 == 0:
                print(f"batch {done}: loss {loss.item():.3f}")
            if done == options.batches:
                break

    val = release.steps(tasks=["grasp"], split="val")
    with torch.no_grad():
        maps = val[range(len(val))].float()
        score = logits_of_actions(model, maps.scene, maps.action)
    wins, losses = score[maps.success], score[~maps.success]
    auc = (wins[:, None] > losses[None]).float().mean()
    print(f"{release.name}, validation: AUC {auc:.2f} over {len(wins)} successes and {len(losses)} failures")


if __name__ == "__main__":
    main()
