"""What networks stored in half precision cost: decisions that change, and outcomes that change with them.

    python benchmarks/half_precision.py --checkpoint releases/checkpoints/rema-v1/joint

Weights are rounded to float16, the statistics of batch normalisations are not: the variances of what comes out of a
cross-convolution, a sum of thousands of products, can be larger than any float16. Both decide the last step of the
first scenarios of the test lists. Where they decide alike the outcome is the same, since the simulation is
deterministic; the other scenarios are simulated with both decisions.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.progress import track
from rich.table import Table

from baselines.tae.checkpoint import load_checkpoint, networks_in, save_checkpoint
from baselines.tae_policy import TaePolicy
from benchmarks.infer import questions
from benchmarks.results import finish, parser
from evaluator.scenarios import load_list
from evaluator.sim.simulator import Simulator
from evaluator.statistics import wilson

SPLIT = "test"


def halved(checkpoint: Path, folder: Path) -> tuple[int, int, int]:
    """Write the networks of a folder again with rounded weights.

    Returns
    -------
    tuple of int
        Bytes of the weights and statistics as they are, and with halved weights; how many statistics no float16 holds.
    """
    before = after = beyond = 0
    for name, path in networks_in(checkpoint).items():
        network, about = load_checkpoint(path)
        weights = {key for key, _ in network.named_parameters()}
        state = network.state_dict()
        before += sum(value.nbytes for value in state.values())
        after += sum(value.nbytes // (1 + (key in weights)) for key, value in state.items())
        beyond += sum(int(value.half().isinf().sum()) for key, value in state.items() if key not in weights)
        rounded = {key: value.half().float() if key in weights else value for key, value in state.items()}
        save_checkpoint(folder, name, rounded, about)
    return before, after, beyond


def decisions(policies: dict[str, TaePolicy], task: str, count: int) -> dict[str, np.ndarray]:
    """Decisions of every policy in the first scenarios of a task."""

    def batches() -> Iterator[list[np.ndarray]]:
        asked = questions(task, count, SPLIT)
        for question in track(asked, task, transient=True):
            yield [policy.act(question) for policy in policies.values()]

    return dict(zip(policies, map(np.concatenate, zip(*batches(), strict=True)), strict=True))


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--checkpoint", type=Path, required=True, help="folder with grasp and push")
    options.add_argument("--tasks", default="grasp,push,grasp_grasp,grasp_push")
    options.add_argument("--scenarios", type=int, default=500, help="of each task (default 500)")
    arguments = options.parse_args()
    table = Table(
        "task",
        "scenarios",
        "different decisions",
        "of these only float32 solved",
        "only float16 solved",
        title="float16",
    )
    simulator, found = Simulator(), []
    with tempfile.TemporaryDirectory() as name:
        before, after, beyond = halved(arguments.checkpoint, Path(name))
        policies = {"float32": TaePolicy(arguments.checkpoint), "float16": TaePolicy(Path(name))}
        for task in arguments.tasks.split(","):
            made = decisions(policies, task, arguments.scenarios)
            situations = [one.last_situation() for one in load_list(task, SPLIT).scenarios[: arguments.scenarios]]
            others = np.flatnonzero(made["float32"] != made["float16"])
            solved = np.array(
                [[simulator.run(situations[n], int(made[way][n])).success for way in policies] for n in others],
                dtype=bool,
            ).reshape(-1, 2)
            lost, won = int((solved[:, 0] & ~solved[:, 1]).sum()), int((~solved[:, 0] & solved[:, 1]).sum())
            low, high = wilson(len(others), len(situations))
            share = f"{len(others)} ({len(others) / len(situations):.1%}; {low:.1%} to {high:.1%})"
            table.add_row(task, f"{len(situations):,}", share, str(lost), str(won))
            found.append({"task": task, "others": len(others), "of": len(situations), "lost": lost, "won": won})
    notes = [
        f"{before / 1e6:.1f} MB in float32, {after / 1e6:.1f} MB with weights in float16; "
        f"{beyond} statistics are too large for float16."
    ]
    return finish(arguments, "half_precision", [table], [], notes, {"found": found})


if __name__ == "__main__":
    sys.exit(main())
