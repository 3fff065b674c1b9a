"""What the success after round 1 depends on: its network trained in other ways on the same data, and scored.

    python benchmarks/ablation.py --output runs/ablation --device cuda --ways as-planned,not-turned,not-turned-slower \
        --json benchmarks/results/ablation.json
    python benchmarks/ablation.py --output runs/ablation-cpu --ways ... --episodes 2000 \
        --json benchmarks/results/ablation_cpu.json

Every way is trained into OUTPUT/WAY/network, as ``rema train`` does it, and scored by ``rema evaluate`` over the test
scenarios of grasp into OUTPUT/WAY/run; what is there already is kept, and what was stopped goes on. The first way is
the plan's; the others are compared with it scenario by scenario.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.table import Table

from baselines.rounds.recursion_plan import load_recursion
from baselines.tae.checkpoint import load_checkpoint
from baselines.train.loop import train
from benchmarks.results import ROOT, finish, parser
from evaluator.leaderboard.comparison import compare
from evaluator.run.reading import read_run
from evaluator.run.run import Run
from evaluator.statistics import wilson
from rema_data.loader.release import Release, load

PLAN = ROOT / "manifests" / "plans" / "rema-v0.toml"
ENTRY = load_recursion(PLAN).rounds[0]
"""Round 1 of the plan."""
(NETWORK,) = ENTRY.networks
PLANNED = "as-planned"


@dataclass(frozen=True, slots=True)
class Way:
    """How a network is trained and scored, where it is not as planned.

    Attributes
    ----------
    title : str
    options : tuple of str
        Of ``rema train``, on top of the plan's; later ones win.
    wrong_labels : float
        Share of the labels of the training split that are turned round before training, 0..1.
    policy : str
        What is scored with the network.
    trained : str or None
        The way whose network it is; its own where this is None.
    """

    title: str
    options: tuple[str, ...] = ()
    wrong_labels: float = 0.0
    policy: str = "tae"
    trained: str | None = None


WAYS = {
    PLANNED: Way("as planned"),
    "not-turned": Way("grasps not rotated", ("--no-rotate",)),
    "not-turned-slower": Way(
        "not rotated, learning rate 1e-4 throughout",
        ("--no-rotate", "--learning-rate", "1e-4", "--schedule", "constant"),
    ),
    "another-seed": Way("another seed", ("--seed", "1")),
    "300-updates": Way("300 updates", ("--updates", "300")),
    "1000-updates": Way("1,000 updates", ("--updates", "1000")),
    "balanced-on-average": Way("balanced on average, not in every minibatch", ("--balance", "average")),
    "wrong-labels": Way("1 % of the training labels wrong", wrong_labels=0.01),
    "finer-cells": Way("features at 9 mm instead of 18", ("--scene-stride", "2", "--ee-stride", "2")),
    "displaced": Way(
        "as planned; the hand arrives up to a pixel (4.5 mm) off",
        policy="benchmarks/policies/displaced.py",
        trained=PLANNED,
    ),
}


def training_command(way: Way, device: str) -> list[str]:
    """The command that trains a way's network, without where it goes."""
    config = NETWORK.config
    return [
        *("rema", "train", "--release", f"releases/{ENTRY.release}"),
        *("--tasks", ",".join(config.tasks), "--primitive", config.primitive),
        *("--updates", str(config.updates), "--validate-every", str(config.validate_every)),
        *("--learning-rate", str(config.learning_rate), "--schedule", config.schedule),
        *(*way.options, "--device", device),
    ]


def mislabelled(release: Release, share: float) -> Release:
    """The release with a share of its training labels turned round, in memory only: of the same steps every time."""
    index, train_split = release.cache.index, release.cache.categories["split"].index("train")
    wrong = np.random.default_rng(0).random(len(index)) < share
    index.setflags(write=True)
    index["success"] ^= wrong & (index["split"] == train_split)
    index.setflags(write=False)
    return release


def train_way(way: Way, folder: Path, device: str) -> None:
    """Train a way's network into a folder."""
    if way.wrong_labels:
        release = mislabelled(load(ROOT / "releases" / ENTRY.release, cache="memory"), way.wrong_labels)
        train(release, NETWORK.config, folder, NETWORK.name, device=device)
    else:
        subprocess.run([*training_command(way, device), "--output", str(folder)], cwd=ROOT, check=True)


def score_way(way: Way, network: Path, folder: Path, episodes: int) -> None:
    """Score a way's network into a run folder."""
    command = ["rema", "evaluate", way.policy, "--checkpoint", str(network), "--task", "grasp"]
    command += ["--episodes", str(episodes), "--device", "openvino", "--output", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True)


def main() -> int:
    """Train, score, compare and print."""
    options = parser(__doc__)
    options.add_argument("--output", type=Path, required=True, metavar="FOLDER")
    options.add_argument("--ways", default=",".join(WAYS), help=f"some of {', '.join(WAYS)} (default: all)")
    options.add_argument("--device", default="cpu", help="that trains (default cpu)")
    options.add_argument("--episodes", type=int, default=10_000, help="scenarios of a way (default 10,000)")
    arguments = options.parse_args()
    names = arguments.ways.split(",")
    if names[0] != PLANNED or not set(names) <= set(WAYS):
        options.error(f"--ways begins with {PLANNED} and names some of {', '.join(WAYS)}")
    output = arguments.output.resolve()
    table = Table("trained", "best after", "validation AUC", "solved", "% [95 %]", title="after round 1")
    for title in ("difference, % [95 %]", "p"):
        table.add_column(title)
    notes, numbers, first = [], {}, None
    for name in names:
        way = WAYS[name]
        network, scored = output / (way.trained or name) / "network", output / name / "run"
        if not (network / f"{NETWORK.name}.json").is_file():
            train_way(way, network, arguments.device)
        if not (scored / "summary.json").is_file():
            score_way(way, network, scored, arguments.episodes)
        run, card = read_run(scored), load_checkpoint(network / NETWORK.name)[1]
        counts = run.counts
        low, high = wilson(counts.successes, counts.eligible)
        difference, p = against(run, first) if first else ("", "")
        first = first or run
        rate = f"{100 * counts.successes / counts.eligible:.2f} [{100 * low:.2f}, {100 * high:.2f}]"
        solved = f"{counts.successes:,} of {counts.eligible:,}"
        auc = f"{card.metrics['auc']:.3f}"
        table.add_row(way.title, f"{card.updates:,}", auc, solved, rate, difference, p)
        if name == PLANNED:
            notes.append(f"{way.title}: `{shlex.join(training_command(way, arguments.device))} --output FOLDER`")
        elif way.options:
            notes.append(f"{way.title}: with `{shlex.join(way.options)}`")
        numbers[way.title] = {"successes": counts.successes, "of": counts.eligible, "card": card.to_dict()}
    return finish(arguments, "ablation", [table], [], notes, numbers)


def against(run: Run, first: Run) -> tuple[str, str]:
    """The paired difference from the first way's run, with its interval, and the p value."""
    found = compare(run, first)
    low, high = found.interval
    shown = f"{100 * found.table.difference:+.2f} [{100 * low:+.2f}, {100 * high:+.2f}]"
    return shown, "< 0.0001" if found.p < 1e-4 else f"{found.p:.4f}"


if __name__ == "__main__":
    sys.exit(main())
