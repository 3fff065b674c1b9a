"""What an evaluation costs beside bare stepping: total time, share of each phase, and the ratio of both.

    python benchmarks/full_run.py --tasks grasp --policies scripted    # runs 10,000 episodes on two workers
    python benchmarks/full_run.py --runs runs/scripted-grasp-conditional runs/random-grasp-conditional

``Bare stepping`` is the time that the run's simulation steps take inside ``stepSimulation`` alone, shared by its
workers without a gap. It is measured by repeating a sample of the run's own episodes, in as many processes at once as
the run had workers, with the clock running only inside ``stepSimulation``; the seconds a step of the sample, times the
steps of the run, divided by the workers. The targets are for scripted policies.
"""

from __future__ import annotations

import json
import multiprocessing
import random
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.results import finish, parser, target
from benchmarks.sim_throughput import StepClock
from evaluator.policy.loading import resolve
from evaluator.runner import EvaluationConfig, run_evaluation
from evaluator.scenarios import load_list
from evaluator.sim.simulator import Simulator
from rema_data.errors import InputError, MissingFileError
from rema_data.schema import TASKS, Situation

RATIOS = {"grasp": 1.25, "push": 1.45}
"""At most, of scripted runs: short episodes have more of what is not stepping."""
WORKERS = 2
WARM_UP = 5
PHASES = ("observe", "infer", "simulate")

Job = tuple[Situation, int]


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of a run, and of its bare stepping shared by its workers."""

    summary: dict[str, Any]
    sampled: int
    step_s: float

    @property
    def total_s(self) -> float:
        """Wall time of the whole run."""
        return float(self.summary["seconds"]["total"])

    @property
    def bare_s(self) -> float:
        """Bare stepping."""
        return float(self.step_s * self.summary["sim_steps"] / self.summary["workers"])


def sample_jobs(folder: Path, summary: dict[str, Any], count: int) -> list[Job]:
    """Some of a run's episodes as situation and action, drawn at random."""
    step = len(TASKS[summary["task"]]) - 1
    scenarios = load_list(summary["task"], summary["split"]).scenarios
    actions = pq.read_table(folder / "results.parquet", columns=[f"step{step}_action"]).column(0).to_pylist()
    acted = [index for index, action in enumerate(actions) if action is not None]
    chosen = sorted(random.Random(3).sample(acted, min(count, len(acted))))
    return [(scenarios[index].last_situation(), actions[index]) for index in chosen]


def bare_stepping(jobs: list[Job]) -> tuple[float, int]:
    """Seconds inside ``stepSimulation``, and steps, of the jobs; the first ones are run twice to warm up."""
    simulator = Simulator()
    for situation, action in jobs[:WARM_UP]:
        simulator.run(situation, action)
    steps = StepClock(simulator)
    for situation, action in jobs:
        simulator.run(situation, action)
    simulator.close()
    return steps.seconds, steps.steps


def cost(folder: Path, sample: int) -> Cost:
    """Cost of a finished run.

    Raises
    ------
    MissingFileError
        There is no finished run in the folder.
    InputError
        It is not a run of the conditional protocol.
    """
    path = folder / "summary.json"
    if not path.is_file():
        raise MissingFileError(f"{folder} holds no finished run", hint="give the folder of a run that has ended")
    summary = json.loads(path.read_text(encoding="utf-8"))
    if summary["protocol"] != "conditional":
        raise InputError(f"{folder} is an {summary['protocol']} run", hint="give runs of the conditional protocol")
    jobs = sample_jobs(folder, summary, sample)
    workers = summary["workers"]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        parts = list(pool.map(bare_stepping, [jobs[start::workers] for start in range(workers)]))
    seconds, steps = sum(part[0] for part in parts), sum(part[1] for part in parts)
    return Cost(summary, len(jobs), seconds / steps if steps else 0.0)


def evaluate(task: str, policy: str, episodes: int, folder: Path) -> Path:
    """A run of a built-in policy, from the start, in a folder below ``folder``."""
    output = folder / f"{policy}-{task}"
    run_evaluation(EvaluationConfig(resolve(policy), task, output, episodes=episodes, workers=WORKERS))
    return output


def report(costs: list[Cost]) -> tuple[Table, list[dict[str, Any]], list[dict[str, Any]]]:
    """The table, the targets and the numbers."""
    table = Table(
        "task", "policy", "episodes", "workers", "total, s", *PHASES, "rest", "steps", "µs/step", "bare, s", "ratio",
        title="whole runs against bare stepping",
    )  # fmt: skip
    targets, numbers = [], []
    for item in costs:
        summary, total, bare = item.summary, item.total_s, item.bare_s
        shares = [summary["seconds"][phase] / total for phase in PHASES]
        ratio = total / bare if bare else float("inf")
        table.add_row(
            summary["task"],
            summary["policy"],
            f"{summary['episodes']:,}",
            str(summary["workers"]),
            f"{total:.1f}",
            *(f"{share:.1%}" for share in shares),
            f"{1 - sum(shares):.1%}",
            f"{summary['sim_steps']:,}",
            f"{1e6 * item.step_s:.0f}",
            f"{bare:.1f}",
            f"{ratio:.2f}",
        )
        numbers.append(
            {
                "task": summary["task"],
                "policy": summary["policy"],
                "episodes": summary["episodes"],
                "seconds": summary["seconds"],
                "bare_seconds": bare,
                "ratio": ratio,
                "sampled": item.sampled,
            }
        )
        most = RATIOS.get(summary["task"])
        if summary["policy"] == "scripted" and most is not None:
            targets.append(
                target(f"{summary['task']}: run over bare stepping", f"<= {most}", f"{ratio:.2f}", ratio <= most)
            )
    return table, targets, numbers


def main() -> int:
    """Run, measure and print."""
    options = parser(__doc__)
    options.add_argument("--tasks", default=",".join(TASKS))
    options.add_argument("--policies", default="random,scripted")
    options.add_argument("--episodes", type=int, default=10_000)
    options.add_argument("--sample", type=int, default=400, help="episodes repeated for the bare stepping")
    options.add_argument("--runs", nargs="+", type=Path, metavar="FOLDER", help="finished runs instead of new ones")
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folders = arguments.runs or [
            evaluate(task, policy, arguments.episodes, Path(temporary))
            for task in arguments.tasks.split(",")
            for policy in arguments.policies.split(",")
        ]
        costs = [cost(folder, arguments.sample) for folder in folders]
    table, targets, numbers = report(costs)
    notes = [
        "Bare stepping: the seconds that stepSimulation takes for one step, times the steps of the run, divided by its "
        "workers. Measured on a random sample of the run's episodes, in as many processes at once as the run had "
        "workers.",
        "Phases are shares of the total; `rest` is start, tables and summary.",
    ]
    return finish(arguments, "full_run", [table], targets, notes, {"runs": numbers})


if __name__ == "__main__":
    sys.exit(main())
