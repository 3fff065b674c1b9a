"""What the success after round 1 depends on: its network trained in other ways on the same data, and scored.

    python benchmarks/ablation.py --output runs/ablation --device cuda --json benchmarks/results/ablation.json

Every way is trained by ``rema train`` into OUTPUT/WAY/network and scored by ``rema evaluate`` over the test scenarios
of grasp into OUTPUT/WAY/run; what is there already is kept, and what was stopped goes on. The first way is the plan's;
the others are compared with it scenario by scenario.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from baselines.rounds.recursion_plan import load_recursion
from baselines.tae.checkpoint import load_checkpoint
from benchmarks.results import ROOT, finish, parser
from evaluator.comparison import compare
from evaluator.scored import ScoredRun, read_run
from evaluator.statistics import wilson

PLAN = ROOT / "manifests" / "plans" / "rema-v0.toml"
WAYS = {
    "as planned": [],
    "grasps not turned": ["--no-rotate"],
    "not turned, learning rate 1e-4 throughout": ["--no-rotate", "--learning-rate", "1e-4", "--schedule", "constant"],
}
"""Options of ``rema train`` on top of the plan's; later ones win."""


def planned() -> list[str]:
    """The command that trains round 1's network as the plan says, without where it goes."""
    entry = load_recursion(PLAN).rounds[0]
    (network,) = entry.networks
    config = network.config
    return [
        *("rema", "train", "--release", f"releases/{entry.release}"),
        *("--tasks", ",".join(config.tasks), "--primitive", config.primitive),
        *("--updates", str(config.updates), "--validate-every", str(config.validate_every)),
        *("--learning-rate", str(config.learning_rate), "--schedule", config.schedule),
    ]


def commands(options: list[str], folder: Path, device: str) -> list[list[str]]:
    """What trains one way and what scores it."""
    return [
        [*planned(), *options, "--device", device, "--output", str(folder / "network")],
        [
            *("rema", "evaluate", "tae", "--checkpoint", str(folder / "network"), "--task", "grasp"),
            *("--device", "openvino", "--output", str(folder / "run")),
        ],
    ]


def main() -> int:
    """Train, score, compare and print."""
    options = parser(__doc__)
    options.add_argument("--output", type=Path, required=True, metavar="FOLDER")
    options.add_argument("--device", default="cpu", help="that trains (default cpu)")
    arguments = options.parse_args()
    table = Table("trained", "validation AUC", "solved", "% [95 %]", "difference, % [95 %]", "p", title="after round 1")
    notes, numbers, first = [], {}, None
    for number, (way, changed) in enumerate(WAYS.items()):
        folder = arguments.output / f"way-{number}"
        products = (folder / "network" / "grasp.json", folder / "run" / "summary.json")
        for command, product in zip(commands(changed, folder, arguments.device), products, strict=True):
            if not product.is_file():
                subprocess.run(command, cwd=ROOT, check=True)
        run, card = read_run(folder / "run"), load_checkpoint(folder / "network" / "grasp")[1]
        counts, auc = run.counts, card.metrics["auc"]
        low, high = wilson(counts.successes, counts.eligible)
        difference, p = against(run, first) if first else ("", "")
        first = first or run
        rate = f"{100 * counts.successes / counts.eligible:.2f} [{100 * low:.2f}, {100 * high:.2f}]"
        table.add_row(way, f"{auc:.3f}", f"{counts.successes:,} of {counts.eligible:,}", rate, difference, p)
        notes.append(f"{way}: `{shlex.join(commands(changed, Path('FOLDER'), arguments.device)[0])}`")
        numbers[way] = {"successes": counts.successes, "of": counts.eligible, "card": card.to_dict()}
    return finish(arguments, "ablation", [table], [], notes, numbers)


def against(run: ScoredRun, first: ScoredRun) -> tuple[str, str]:
    """The paired difference from the first way's run, with its interval, and the p value."""
    found = compare(run, first)
    low, high = found.interval
    shown = f"{100 * found.table.difference:+.2f} [{100 * low:+.2f}, {100 * high:+.2f}]"
    return shown, "< 0.0001" if found.p < 1e-4 else f"{found.p:.4f}"


if __name__ == "__main__":
    sys.exit(main())
