"""Training speed: this training against the same network written the straightforward way, on the same data, in turns.

    python benchmarks/train.py                                         # rema-mini, batches of 8
    python benchmarks/train.py --device cuda --batches 8,32,128,512,2048 --updates 8 # where a GPU is at hand

    python benchmarks/train.py --tried                                 # other ways to be faster, too

Straightforward: every sample is read and converted by itself, the cross-convolution loops over the batch, and tensors
are contiguous. All augment, balance and turn alike, and compute the same loss of the same network.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import torch
from rich.table import Table
from torch import Tensor
from torch.nn import functional
from torch.profiler import ProfilerActivity, profile

import rema_data
from baselines.tae import network as tae
from baselines.tae.network import TaeNetwork
from baselines.train.config import TrainingConfig
from baselines.train.data import Samples, TrainingData, open_data, prepared
from baselines.train.validation import pixel_logits
from benchmarks.results import finish, parser, target
from rema_data.augment import Augment
from rema_data.loader.batch import StepBatch

WANTED_RATIO, WANTED_WAIT = 2.0, 0.05
"""On a CPU; a GPU is reported."""
SATURATED = 0.9
PROFILED = 4
"""Updates whose convolutions are timed."""
TRIED = {"ours, in bfloat16": {"half": True}, "ours, torch.compile": {"compiled": True}}


def looped(features: Tensor, kernels: Tensor) -> Tensor:
    """The cross-convolution, one sample after the other."""
    size, channels = kernels.shape[-1], features.shape[1]
    before, after = size // 2, (size - 1) // 2
    padded = functional.pad(features, (before, after, before, after))
    pairs = zip(padded, kernels, strict=True)
    return torch.stack([functional.conv2d(one[None], own[:, None], groups=channels)[0] for one, own in pairs])


class Turn:
    """One way to train: so many updates at a time, timed.

    Parameters
    ----------
    data : TrainingData
    device : torch.device
    plain : bool
        The straightforward way.
    half, compiled : bool
        In bfloat16; through torch.compile.
    """

    def __init__(
        self,
        data: TrainingData,
        device: torch.device,
        *,
        plain: bool = False,
        half: bool = False,
        compiled: bool = False,
    ) -> None:
        self.data, self.device, self.plain, self.half = data, device, plain, half
        self.network = TaeNetwork(generator=torch.Generator().manual_seed(0)).train()
        self.network = self.network.to(device) if plain else self.network.placed(device)
        self.forward = torch.compile(self.network) if compiled else self.network
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=1e-4)
        self.random = torch.Generator().manual_seed(1)
        self.augment = Augment(data.train)
        self.batches = self.one_by_one() if plain else data.batches()
        self.waited = self.took = 0.0
        self.samples = 0

    def one_by_one(self) -> Any:
        while True:
            for rows in self.data.sampler:
                singles = [self.data.train[int(row)] for row in rows]
                parts = zip(*(single.tensors for single in singles), strict=True)
                yield StepBatch(*(torch.cat(part) for part in parts))

    def run(self, updates: int) -> None:
        """So many updates more."""
        grouped = tae.cross_convolve
        if self.plain:
            tae.cross_convolve = looped
        try:
            for _ in range(updates):
                began = time.perf_counter()
                samples = prepared(next(self.batches), self.augment, self.random, self.device)
                if self.plain:
                    samples = Samples(samples.scene.contiguous(), samples.end_effector.contiguous(), *samples[2:])
                self.waited += time.perf_counter() - began
                self.step(samples)
                self.synchronise()
                self.took += time.perf_counter() - began
                self.samples += len(samples.pixel)
        finally:
            tae.cross_convolve = grouped

    def step(self, samples: Samples) -> None:
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.half):
            logits = self.forward(samples.scene, samples.end_effector)
        pair = pixel_logits(logits.float(), samples.pixel)
        loss = functional.cross_entropy(pair, samples.success.long())
        self.optimiser.zero_grad()
        torch.autograd.backward(loss)
        self.optimiser.step()

    def synchronise(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)

    def forget(self) -> None:
        self.waited, self.took, self.samples = 0.0, 0.0, 0


def measure(arguments: argparse.Namespace, batch_size: int, primitive: str) -> dict[str, Any]:
    """Samples a second of both ways at one batch size, in turns; the first turn is not counted."""
    tasks = ("grasp", "grasp_grasp", "grasp_push") if primitive == "grasp" else ("push", "grasp_push")
    config = TrainingConfig(primitive, tasks, batch_size=batch_size)
    release, device = rema_data.load(arguments.release), torch.device(arguments.device)
    ways = {"ours": {}, "straightforward": {"plain": True}, **(TRIED if arguments.tried else {})}
    turns = {name: Turn(open_data(release, config), device, **way) for name, way in ways.items()}
    speeds: dict[str, list[float]] = {name: [] for name in turns}
    waits: dict[str, list[float]] = {name: [] for name in turns}
    for number in range(arguments.repeats + 1):
        for name, turn in turns.items():
            turn.forget()
            turn.run(arguments.updates)
            if number:
                speeds[name].append(turn.samples / turn.took)
                waits[name].append(turn.waited / turn.took)
    pairs = zip(speeds["ours"], speeds["straightforward"], strict=True)
    ratio = median(ours / theirs for ours, theirs in pairs)
    return {
        "primitive": primitive,
        "batch": batch_size,
        "speeds": speeds,
        "waits": waits,
        "ratio": ratio,
        "convolutions": convolutions(turns["ours"]) if device.type == "cpu" else None,
    }


def convolutions(turn: Turn) -> float:
    """Share of the processor's time of some updates that is spent in convolutions, which no way does without."""
    with profile(activities=[ProfilerActivity.CPU]) as watched:
        turn.run(PROFILED)
    events = watched.key_averages()
    total = sum(event.self_cpu_time_total for event in events)
    return float(sum(event.self_cpu_time_total for event in events if "convolution" in event.key) / total)


def saturation(found: list[dict[str, Any]], primitive: str) -> str:
    """From which batch size on a larger one brings little."""
    ours = {row["batch"]: median(row["speeds"]["ours"]) for row in found if row["primitive"] == primitive}
    best = max(ours.values())
    enough = min(size for size, speed in ours.items() if speed >= SATURATED * best)
    return f"{primitive}: batches of {enough:,} reach {SATURATED:.0%} of the best speed, {best:,.0f} samples/s."


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--release", default="rema-mini")
    options.add_argument("--device", default="cpu")
    options.add_argument("--batches", default="8", help="batch sizes (default 8)")
    options.add_argument("--primitives", default="grasp,push")
    options.add_argument("--tried", action="store_true", help="also what was tried and not taken")
    options.add_argument("--updates", type=int, default=20, help="of a turn (default 20)")
    options.add_argument("--repeats", type=int, default=3, help="turns of each way (default 3)")
    arguments = options.parse_args()
    sizes, primitives = [int(size) for size in arguments.batches.split(",")], arguments.primitives.split(",")
    found = [measure(arguments, size, primitive) for size in sizes for primitive in primitives]
    table = Table("primitive", "batch", "way", "samples/s", "each repeat", "waiting for data", title="training")
    pick: Callable[[list[float]], float] = median
    for row in found:
        for name, speeds in row["speeds"].items():
            each = ", ".join(f"{speed:.1f}" for speed in speeds)
            share = f"{pick(row['waits'][name]):.1%}"
            table.add_row(row["primitive"], str(row["batch"]), name, f"{pick(speeds):.1f}", each, share)
    targets = []
    for row in found if arguments.device == "cpu" else ():
        what = f"{row['primitive']}, batches of {row['batch']}"
        wait = pick(row["waits"]["ours"])
        ratio = row["ratio"]
        targets.append(target(f"{what}: straightforward", ">= 2 times", f"{ratio:.1f}", ratio >= WANTED_RATIO))
        targets.append(target(f"{what}: waiting for data", "< 5%", f"{wait:.1%}", wait < WANTED_WAIT))
    name = torch.cuda.get_device_name(arguments.device) if arguments.device.startswith("cuda") else arguments.device
    notes = [f"Device: {name}, {torch.get_num_threads()} threads; torch {torch.__version__}."]
    if arguments.device == "cpu":
        shares = ", ".join(f"{row['convolutions']:.0%} ({row['primitive']})" for row in found)
        notes.append(f"Convolutions take {shares} of the time of `ours`; both ways compute all of them.")
    if len(sizes) > 1:
        notes += [saturation(found, primitive) for primitive in primitives]
    return finish(arguments, "train", [table], targets, notes, {"found": found})


if __name__ == "__main__":
    sys.exit(main())
