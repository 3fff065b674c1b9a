"""Does a worker's resident memory stay small? Growth over many episodes in one process, and two workers of a run.

    python benchmarks/memory.py                                        # 10,000 episodes, grasp
    python benchmarks/memory.py --tasks grasp,push,grasp_push --episodes 2000

The episodes are random and scripted in turns, a set of cases run again and again. Growth is counted from the end of
200 episodes of warm-up. The two workers are those of the engine that evaluates; their sum is sampled while they run.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import psutil
from rich.table import Table

from benchmarks.results import finish, parser, target
from benchmarks.situations import Case, draw_cases
from evaluator.engines import Job, JobBatch
from evaluator.engines.process import ProcessEngine
from evaluator.sim.simulator import Simulator

WARM_UP = 200
GROWTH_LIMIT_MB = 50.0
WORKERS_LIMIT_MB = 1024.0
DISTINCT = 200
"""Episodes of each task that are drawn."""
SAMPLES = 10
SHARD = 25
MB = 2**20


def growth(cases: list[Case], episodes: int) -> list[tuple[int, float]]:
    """Resident memory of this process (MB) after so many episodes, the first after the warm-up."""
    process = psutil.Process()
    simulator = Simulator()
    samples = []
    every = max(1, episodes // SAMPLES)
    for number in range(WARM_UP + episodes):
        case = cases[number % len(cases)]
        simulator.run(case.situation, case.action)
        done = number + 1 - WARM_UP
        if done >= 0 and (done % every == 0 or done == episodes):
            samples.append((done, process.memory_info().rss / MB))
    simulator.close()
    return samples


def two_workers(cases: list[Case], episodes: int) -> tuple[float, float]:
    """Largest sum of the resident memory of two workers, and of one of them, MB."""
    engine = ProcessEngine(workers=2)
    jobs = [Job(n, cases[n % len(cases)].situation, cases[n % len(cases)].action) for n in range(episodes)]
    batches: list[JobBatch] = [tuple(jobs[start : start + SHARD]) for start in range(0, len(jobs), SHARD)]
    most = largest = 0.0
    own = psutil.Process(os.getpid())
    for number, _ in enumerate(engine.map(batches)):
        if number % 5:
            continue
        sizes = [child.memory_info().rss / MB for child in own.children(recursive=True) if child.is_running()]
        most, largest = max(most, sum(sizes)), max(largest, *sizes, 0.0)
    engine.close()
    return most, largest


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--tasks", default="grasp")
    options.add_argument("--episodes", type=int, default=10_000)
    options.add_argument("--engine-episodes", type=int, default=1000, help="of the two workers (default 1000)")
    arguments = options.parse_args()
    tasks = arguments.tasks.split(",")
    simulator = Simulator()
    drawn = [draw_cases(task, ["random", "scripted"], DISTINCT // len(tasks), simulator)[0] for task in tasks]
    simulator.close()
    cases = [case for together in zip(*drawn, strict=True) for case in together]

    most, largest = two_workers(cases, arguments.engine_episodes)
    samples = growth(cases, arguments.episodes)
    grown = samples[-1][1] - samples[0][1]
    table = Table("episodes after the warm-up", "resident, MB", title=f"one process, {', '.join(tasks)}")
    for done, size in samples:
        table.add_row(f"{done:,}", f"{size:.1f}")
    workers = Table("two workers together, MB", "the larger one, MB", title=f"{arguments.engine_episodes:,} episodes")
    workers.add_row(f"{most:.0f}", f"{largest:.0f}")
    targets = [
        target(
            f"growth over {arguments.episodes:,} episodes",
            f"< {GROWTH_LIMIT_MB:.0f} MB",
            f"{grown:.1f} MB",
            grown < GROWTH_LIMIT_MB,
        ),
        target("two workers together", f"< {WORKERS_LIMIT_MB:.0f} MB", f"{most:.0f} MB", most < WORKERS_LIMIT_MB),
    ]
    numbers = {"growth_mb": grown, "samples": samples, "two_workers_mb": most, "worker_mb": largest, "tasks": tasks}
    return finish(arguments, "memory", [table, workers], targets, [], numbers)


if __name__ == "__main__":
    sys.exit(main())
