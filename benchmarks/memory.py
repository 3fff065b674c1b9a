"""Does memory stay small? A worker over many episodes in one process, two workers of a run, and a training.

    python benchmarks/memory.py                                        # 10,000 episodes, grasp
    python benchmarks/memory.py --tasks grasp,push,grasp_push --episodes 2000

The episodes are random and scripted in turns, a set of cases run again and again. Growth is counted from the end of
200 episodes of warm-up. The two workers are those of the engine that evaluates; their sum is sampled while they run.
Of a training its own memory counts, not the pages of the decoded cache that it shares with the system.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import psutil
from rich.table import Table

from benchmarks.results import finish, parser, target
from benchmarks.situations import Case, draw_cases
from evaluator.engines import Job, JobBatch
from evaluator.engines.process import ProcessEngine
from evaluator.sim.simulator import Simulator
from rema_data.release.folder import find_release

WARM_UP = 200
GROWTH_LIMIT_MB = 50.0
WORKERS_LIMIT_MB = 1024.0
TRAINING_LIMIT_MB = 2048.0
SAMPLED_S = 0.1
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


def training(release: str, updates: int) -> tuple[float, float]:
    """Largest own memory of a training, and largest resident memory with the pages of mapped files, MB."""
    with tempfile.TemporaryDirectory() as temporary:
        words = f"--primitive grasp --tasks grasp --updates {updates} --validate-every {updates}".split()
        command = [sys.executable, "-m", "evaluator.cli", "train", "--release", release, "--output", temporary, *words]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
            own = resident = 0.0
            while process.poll() is None:
                with suppress(psutil.Error):
                    found = psutil.Process(process.pid).memory_info()
                    own, resident = max(own, (found.rss - found.shared) / MB), max(resident, found.rss / MB)
                time.sleep(SAMPLED_S)
            if process.returncode:
                sys.exit(process.stderr.read() if process.stderr else "the training failed")
    return own, resident


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--tasks", default="grasp")
    options.add_argument("--episodes", type=int, default=10_000)
    options.add_argument("--engine-episodes", type=int, default=1000, help="of the two workers (default 1000)")
    options.add_argument("--release", help="of the training (default: the newest here)")
    options.add_argument("--updates", type=int, default=50, help="of the training (default 50)")
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
    release = find_release(arguments.release)
    own_mb, resident_mb = training(str(release.path), arguments.updates)
    trained = Table(
        "its own memory, MB", "with pages of mapped files, MB", title=f"training on {release.manifest.name}"
    )
    trained.add_row(f"{own_mb:.0f}", f"{resident_mb:.0f}")
    targets = [
        target(
            f"growth over {arguments.episodes:,} episodes",
            f"< {GROWTH_LIMIT_MB:.0f} MB",
            f"{grown:.1f} MB",
            grown < GROWTH_LIMIT_MB,
        ),
        target("two workers together", f"< {WORKERS_LIMIT_MB:.0f} MB", f"{most:.0f} MB", most < WORKERS_LIMIT_MB),
        target("a training", f"< {TRAINING_LIMIT_MB:.0f} MB", f"{own_mb:.0f} MB", own_mb < TRAINING_LIMIT_MB),
    ]
    numbers = {"growth_mb": grown, "samples": samples, "two_workers_mb": most, "worker_mb": largest, "tasks": tasks}
    numbers |= {"training_mb": own_mb, "training_resident_mb": resident_mb}
    return finish(arguments, "memory", [table, workers, trained], targets, [], numbers)


if __name__ == "__main__":
    sys.exit(main())
