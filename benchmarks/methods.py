"""Is one network a primitive (joint) better than one a skill (separate)? Rates of methods, over training seeds.

    python benchmarks/methods.py --output runs/methods --train 1/2 &       # two at a time, one core each
    python benchmarks/methods.py --output runs/methods --train 2/2
    python benchmarks/methods.py --output runs/methods --json benchmarks/results/methods.json

Networks are those of the last round of the plan, trained with seeds 0 to 2 on a tenth of the training episodes (seed K
on the subset ``10pct-rK+1``, so that a seed stands for other data, too) and on all of them (seed 0: the networks of the
plan itself). All are scored on the validation scenarios of every task: the test scenarios choose nothing. What is there
already is kept, and what was stopped goes on.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.table import Table

from baselines.rounds.recursion_plan import NetworkPlan, RecursionPlan, load_recursion
from baselines.train.loop import train
from benchmarks.results import ROOT, finish, parser
from evaluator import evaluate, read_run
from evaluator.cli.progress import StderrProgress
from evaluator.policy.shipped import CHECKPOINTS
from evaluator.statistics.methods import MethodDifference, MethodRate, Solved, method_difference, method_rate
from rema_data.loader.release import load

PLAN = ROOT / "manifests" / "plans" / "rema-v1.toml"
FIGURE = ROOT / "docs" / "images" / "methods.png"
METHODS = {"joint": "tae-joint", "separate": "tae-separate"}
"""Folder of the networks of a method, and the policy that plays them."""
SIZES = {"10pct": 10, "100pct": 100}
"""Percent of the training episodes."""
SEEDS = (0, 1, 2)
TASKS = ("grasp", "push", "grasp_grasp", "grasp_push")
EPISODES = 2_000


@dataclass(frozen=True, slots=True)
class Training:
    """The networks of a method, on a share of the data, with a seed."""

    method: str
    size: str
    seed: int

    @property
    def subset(self) -> str | None:
        """The subset that it is trained on; all training episodes where this is None."""
        return None if SIZES[self.size] == 100 else f"{self.size}-r{self.seed + 1}"

    def folder(self, plan: RecursionPlan, output: Path) -> Path:
        """Where its networks are."""
        if self.size == "100pct" and self.seed == 0:
            return ROOT / "releases" / CHECKPOINTS / plan.name / self.method
        return output / self.size / self.method / f"seed-{self.seed}"

    def run(self, task: str, output: Path) -> Path:
        """Where its run in a task is."""
        return output / "runs" / f"{self.size}-{self.method}-seed-{self.seed}-{task}"


TRAININGS = [Training(method, size, seed) for size in SIZES for seed in SEEDS for method in METHODS]


def missing_networks(plan: RecursionPlan, output: Path) -> Iterator[tuple[Training, NetworkPlan]]:
    """Networks that are not trained yet, those of the smaller share first."""
    for training in TRAININGS:
        for network in plan.rounds[-1].networks:
            card = training.folder(plan, output) / f"{network.name}.json"
            if network.folder == training.method and not card.is_file():
                yield training, network


def train_missing(plan: RecursionPlan, output: Path, part: int, parts: int, device: str) -> None:
    """Train every ``parts``-th of the missing networks."""
    release = load(ROOT / "releases" / plan.name)
    with StderrProgress() as progress:
        for training, network in list(missing_networks(plan, output))[part - 1 :: parts]:
            config = dataclasses.replace(network.config, seed=training.seed, subset=training.subset)
            folder = training.folder(plan, output)
            train(release, config, folder, network.name, device=device, progress=progress)


def solved(method: str, size: str, task: str, plan: RecursionPlan, output: Path) -> Solved:
    """Which scenarios the networks of every seed solve, bool (seeds, scenarios); played where that is not known."""
    rows = []
    for training in (one for one in TRAININGS if (one.method, one.size) == (method, size)):
        with StderrProgress() as progress:
            result = evaluate(
                METHODS[method],
                task=task,
                split="val",
                episodes=EPISODES,
                checkpoint=training.folder(plan, output),
                device="openvino",
                output=training.run(task, output),
                progress=progress,
            )
        rows.append(read_run(result.folder).table["success"].to_numpy(zero_copy_only=False))
    return np.array(rows, bool)


def draw(rates: dict[tuple[str, str, str], MethodRate], path: Path) -> None:
    """A panel a task: every seed, the mean over seeds and its interval, by the share of the data."""
    figure = Figure(figsize=(9, 2.6), dpi=150, facecolor="white", layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, len(TASKS)))
    for axes, task in zip(panels, TASKS, strict=True):
        for place, method in enumerate(METHODS):
            for size, percent in SIZES.items():
                found = rates[method, size, task]
                x = percent * (0.93 if place == 0 else 1.07)
                axes.plot([x] * len(found.by_seed), [100 * rate for rate in found.by_seed], ".", color=f"C{place}")
                errors = [[100 * (found.mean - found.low)], [100 * (found.high - found.mean)]]
                label = method if size == "100pct" and task == TASKS[0] else None
                axes.errorbar([x], [100 * found.mean], errors, marker="_", capsize=3, color=f"C{place}", label=label)
        axes.set_xscale("log")
        axes.set_xlim(6, 160)
        axes.set_xticks([10, 100], ["10", "100"])
        axes.minorticks_off()
        axes.set_title(task, fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("success, % of validation scenarios", fontsize=8)
    figure.supxlabel("% of the training episodes", fontsize=8)
    panels[0].legend(frameon=False, fontsize=8)
    FigureCanvasAgg(figure).print_png(str(path))


def shown_rate(found: MethodRate) -> str:
    """Mean, interval, and the rate of every seed."""
    seeds = ", ".join(f"{100 * rate:.1f}" for rate in found.by_seed)
    return f"{100 * found.mean:.1f} [{100 * found.low:.1f}, {100 * found.high:.1f}] ({seeds})"


def shown_difference(found: MethodDifference) -> tuple[str, str]:
    """Difference, and probability of improvement, each with its interval."""
    return (
        f"{100 * found.difference:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]",
        f"{found.improvement:.2f} [{found.improvement_low:.2f}, {found.improvement_high:.2f}]",
    )


def report(plan: RecursionPlan, arguments: argparse.Namespace) -> int:
    """Score, compare, draw and print."""
    by_task = Table(
        "data", "method", *TASKS, title="methods: success, % of 2,000 validation scenarios: mean [95 %] (seeds)"
    )
    gaps = Table(
        "data", "task", "joint - separate, points [95 %]", "P(joint better)", title="methods: joint against separate"
    )
    rates: dict[tuple[str, str, str], MethodRate] = {}
    numbers: dict[str, Any] = {}
    for size, percent in SIZES.items():
        outcomes = {
            (method, task): solved(method, size, task, plan, arguments.output) for method in METHODS for task in TASKS
        }
        for method in METHODS:
            own = {task: method_rate(outcomes[method, task]) for task in TASKS}
            rates |= {(method, size, task): found for task, found in own.items()}
            by_task.add_row(f"{percent} %", method, *(shown_rate(found) for found in own.values()))
        for task in TASKS:
            gap = method_difference(outcomes["joint", task], outcomes["separate", task])
            gaps.add_row(f"{percent} %", task, *shown_difference(gap))
            numbers[f"{size} {task}"] = {
                "difference": dataclasses.asdict(gap),
                **{method: dataclasses.asdict(rates[method, size, task]) for method in METHODS},
            }
    draw(rates, FIGURE)
    notes = [
        f"Networks of {len(SEEDS)} training seeds; the interval draws seeds and scenarios again (10,000 times). "
        "P(joint better) is the probability that a network of joint solves more than one of separate.",
        "Rounds 2 to 4 of the data were collected by networks that were trained on everything before, tool steps "
        "included: both methods learn from data that a joint policy collected.",
    ]
    return finish(arguments, "methods", [by_task, gaps], [], notes, numbers)


def main() -> int:
    """Train a part of the networks, or score and compare all of them."""
    options = parser(__doc__)
    options.add_argument("--output", type=Path, required=True, metavar="FOLDER")
    options.add_argument("--train", metavar="I/N", help="train the I-th of N parts of what is missing, and stop")
    options.add_argument("--device", default="cpu", help="that trains (default cpu)")
    arguments = options.parse_args()
    arguments.output = arguments.output.resolve()
    plan = load_recursion(PLAN)
    if arguments.train:
        part, _, parts = arguments.train.partition("/")
        train_missing(plan, arguments.output, int(part), int(parts), arguments.device)
        return 0
    if missing := list(missing_networks(plan, arguments.output)):
        options.error(f"{len(missing)} networks are not trained yet: --train 1/1")
    return report(plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
