"""Random and scripted success rates of the world beside the paper's, with Wilson intervals.

    python benchmarks/calibrate.py                                  # all eight rates, 5,000 episodes each
    python benchmarks/calibrate.py --tasks grasp --episodes 2000 --set length_max_m=0.13

Episodes come from the ``calibrate`` seed domain, which no frozen scenario and no collected episode shares. Tools are
picked up by the privileged reference pick. ``--set`` tries another value of a constant of ``WorldParameters``.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import multiprocessing
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from evaluator.leaderboard.published import published_rate
from evaluator.sim.kinds import KINDS
from evaluator.sim.parameters import WORLD, WorldParameters, parameters_hash
from evaluator.sim.reach import reachable
from evaluator.sim.reference import prepare
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import episode_generator
from rema_data import grid
from rema_data.schema import TASKS

PUBLISHED_TASKS = [task for task in TASKS if published_rate("random", task) is not None]
ROOT_SEED = 20211201


def published_percent(policy: str, task: str) -> float | None:
    """The paper's rate, percent; None where it has none."""
    share = published_rate(policy, task)
    return None if share is None else 100 * share


def count(job: tuple[str, range, WorldParameters]) -> dict[str, collections.Counter[str]]:
    """Outcomes of the last step of some episodes, by policy."""
    task, episodes, parameters = job
    simulator = Simulator(parameters)
    last = len(TASKS[task]) - 1
    kind = TASKS[task][last]
    valid = np.flatnonzero(reachable(kind, parameters).any(axis=0))
    counts: dict[str, collections.Counter[str]] = {"random": collections.Counter(), "scripted": collections.Counter()}
    for episode in episodes:
        rng = episode_generator(ROOT_SEED, "calibrate", task, episode)
        situation = prepare(simulator, task, rng).scenario(task).last_situation()
        x_m, y_m = KINDS[kind].aim(situation.target, parameters)
        yaw = float(rng.integers(kind.angles)) * 2 * np.pi / grid.ANGLES
        actions = {
            "random": int(valid[rng.integers(len(valid))]),
            "scripted": int(grid.snap(x_m, y_m, yaw)),
        }
        for policy, action in actions.items():
            outcome = simulator.run(situation, action)
            counts[policy][outcome.failure or "success"] += 1
    simulator.close()
    return counts


def measure(task: str, episodes: int, parameters: WorldParameters, pool: Any) -> list[dict[str, Any]]:
    """Rates of both policies on one task, with intervals and the published rates."""
    from scipy.stats import binomtest

    started = time.perf_counter()
    jobs = [(task, range(start, min(start + 25, episodes)), parameters) for start in range(0, episodes, 25)]
    total: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for counts in pool.imap_unordered(count, jobs):
        for policy, counter in counts.items():
            total[policy].update(counter)
    rows = []
    for policy, counter in total.items():
        eligible = sum(counter.values())
        successes = counter["success"]
        interval = binomtest(successes, eligible).proportion_ci(method="wilson")
        rows.append(
            {
                "task": task,
                "policy": policy,
                "episodes": eligible,
                "successes": successes,
                "rate": 100 * successes / eligible,
                "low": 100 * interval.low,
                "high": 100 * interval.high,
                "published": published_percent(policy, task),
                "outcomes": dict(sorted(((str(key), value) for key, value in counter.items()), key=lambda kv: -kv[1])),
                "seconds": time.perf_counter() - started,
            }
        )
    return rows


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table as Markdown."""
    lines = ["| task | policy | episodes | ours, % | 95 % | paper, % | difference |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        paper = "-" if row["published"] is None else f"{row['published']:.2f}"
        gap = "-" if row["published"] is None else f"{row['rate'] - row['published']:+.2f}"
        lines.append(
            f"| {row['task']} | {row['policy']} | {row['episodes']} | {row['rate']:.2f} "
            f"| {row['low']:.1f} to {row['high']:.1f} | {paper} | {gap} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure and print; ``--json`` also writes the rows to a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", default=",".join(PUBLISHED_TASKS))
    parser.add_argument("--episodes", type=int, default=5000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", dest="changes")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    changes = {}
    for change in arguments.changes:
        name, _, value = change.partition("=")
        changes[name] = type(getattr(WORLD, name))(float(value))
    parameters = dataclasses.replace(WORLD, **changes)
    rows: list[dict[str, Any]] = []
    context = multiprocessing.get_context("spawn")
    with context.Pool(arguments.workers) as pool:
        for task in arguments.tasks.split(","):
            found = measure(task, arguments.episodes, parameters, pool)
            rows += found
            for row in found:
                print(f"# {task} {row['policy']}: {row['outcomes']} {row['seconds']:.0f} s", file=sys.stderr)
    print(f"\nparameters {parameters_hash(parameters)[:12]} {changes or ''}\n\n{markdown(rows)}")
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"parameters": parameters_hash(parameters), "rows": rows}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
