"""Is the geometric shortcut right? Simulates what it would label ``missed`` without simulation, and compares.

    python benchmarks/shortcuts.py                                     # 2,000 cases a task
    python benchmarks/shortcuts.py --episodes 100 --tasks push

Cases are random and scripted actions. Only those that the shortcut answers are simulated in full: each must come out
as ``missed`` with the target untouched. Exits with 6 if one does not.
"""

from __future__ import annotations

import multiprocessing
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from benchmarks.situations import draw_cases
from evaluator.sim.simulator import Simulator
from rema_data.schema import TASKS, Failure

BLOCK = 50
POLICIES = ("random", "scripted")
BLOCK_STRIDE = 100_000
"""Distance of the first seeds of two blocks: passed-over episodes never run into the next block."""

Counts = Counter[tuple[str, str, str]]


def count(job: tuple[str, int, int]) -> tuple[Counts, list[str]]:
    """Outcomes of a block of episodes by (task, policy, kind), and a line for every difference."""
    task, block, episodes = job
    quick, full = Simulator(), Simulator(shortcuts=False)
    counts: Counts = Counter()
    different = []
    cases, _ = draw_cases(task, POLICIES, episodes, quick, block * BLOCK_STRIDE)
    for case in cases:
        counts[task, case.policy, "cases"] += 1
        answer = quick.run(case.situation, case.action)
        if answer.sim_steps or answer.failure is not Failure.MISSED:
            continue
        counts[task, case.policy, "shortcut"] += 1
        truth = full.run(case.situation, case.action)
        if truth.failure is not Failure.MISSED or truth.contact_steps or truth.illegal_steps:
            counts[task, case.policy, "different"] += 1
            different.append(
                f"{task} {case.policy} episode {case.episode} action {case.action}: {truth.failure or 'success'}"
            )
    quick.close()
    full.close()
    return counts, different


def main() -> int:
    """Measure and print; the exit code is 6 if a label differs."""
    options = parser(__doc__)
    options.add_argument("--tasks", default=",".join(TASKS))
    options.add_argument("--episodes", type=int, default=2000, help="cases of each task, half of them random")
    options.add_argument("--workers", type=int, default=2)
    arguments = options.parse_args()
    tasks = arguments.tasks.split(",")
    situations = -(-arguments.episodes // len(POLICIES))
    jobs = [
        (task, number, min(BLOCK, situations - start))
        for task in tasks
        for number, start in enumerate(range(0, situations, BLOCK))
    ]
    counts: Counts = Counter()
    notes: list[str] = []
    with ProcessPoolExecutor(arguments.workers, multiprocessing.get_context("spawn")) as pool:
        for found, different in pool.map(count, jobs):
            counts.update(found)
            notes += different
    table = Table("task", "policy", "cases", "shortcut", "share", "different", title="shortcut against simulation")
    for task in tasks:
        for policy in POLICIES:
            cases, short, other = (counts[task, policy, kind] for kind in ("cases", "shortcut", "different"))
            table.add_row(task, policy, str(cases), str(short), f"{short / cases:.1%}", str(other))
    targets = [target("labels that differ", "0", str(len(notes)), not notes)]
    numbers = {" ".join(key): value for key, value in sorted(counts.items())}
    return finish(arguments, "shortcuts", [table], targets, notes, dict(numbers), mismatch=bool(notes))


if __name__ == "__main__":
    sys.exit(main())
