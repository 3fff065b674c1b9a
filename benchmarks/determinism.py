"""Is an episode a pure function of its situation and action? Compares the same cases under different histories.

    python benchmarks/determinism.py                                   # 300 episodes a task, three policies
    python benchmarks/determinism.py --episodes 20 --others 100 --tasks grasp,push

Every case is hashed: all fields of its outcome and, bit for bit, the poses, velocities and joint states in which the
simulation ended. Each history has a process of its own: forward (the reference), forward again, reversed, all tasks
interleaved, after other episodes, with the Bullet world rebuilt at random points. Exits with 6 if one hash differs.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import pickle
import random
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from benchmarks.situations import POLICIES, Case, draw_cases
from evaluator.sim.simulator import Simulator
from rema_data.schema import TASKS, StepOutcome, to_dict

OTHERS_START = 1_000_000
"""First episode of the ones that only make history."""
REBUILD_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class History:
    """What a process does with the cases.

    Attributes
    ----------
    name : str
    order : tuple of int
        Positions of the cases, in the order in which they are run.
    others_first : bool
        Whether other episodes are run before them.
    rebuilds : bool
        Whether the worlds are rebuilt at random points in between.
    """

    name: str
    order: tuple[int, ...]
    others_first: bool = False
    rebuilds: bool = False


Verdict = tuple[str, str]
"""Hash of everything, and the label."""


def digest(simulator: Simulator, case: Case) -> Verdict:
    """Run a case and hash its outcome with the state in which the simulation ended."""
    outcome = simulator.run(case.situation, case.action)
    total = hashlib.sha256(repr(to_dict(outcome)).encode())
    if outcome.sim_steps:
        for part in final_state(simulator, outcome):
            total.update(repr(part).encode())
    return total.hexdigest(), str(outcome.failure or "success")


def final_state(simulator: Simulator, outcome: StepOutcome) -> list[object]:
    """Poses and velocities of all bodies, joint states of the arms, as the last simulation left them."""
    world = simulator.world
    client = world.client
    state: list[object] = []
    for body in (client.getBodyUniqueId(n) for n in range(client.getNumBodies())):
        state += [client.getBasePositionAndOrientation(body), client.getBaseVelocity(body)]
    for arm in world.arms.values():
        joints = range(client.getNumJoints(arm.body))
        state += [(position, speed, torque) for position, speed, _, torque in client.getJointStates(arm.body, joints)]
    return state


def run_history(history: History, cases_file: str) -> list[Verdict]:
    """Verdicts of all cases, by position; the whole content of one fresh process."""
    cases, others = pickle.loads(Path(cases_file).read_bytes())
    simulator = Simulator()
    rng = random.Random(7)
    if history.others_first:
        for case in others:
            simulator.run(case.situation, case.action)
    verdicts: dict[int, Verdict] = {}
    for position in history.order:
        if history.rebuilds and rng.random() < REBUILD_SHARE:
            for arms in (("left",), ("right",), ("left", "right")):
                simulator.world.begin(arms)
        verdicts[position] = digest(simulator, cases[position])
    simulator.close()
    return [verdicts[position] for position in range(len(cases))]


def histories(count: int) -> list[History]:
    """The histories that are compared; the first is the reference."""
    forward = tuple(range(count))
    shuffled = random.Random(1).sample(forward, count)
    return [
        History("forward", forward),
        History("fresh process", forward),
        History("reversed", forward[::-1]),
        History("interleaved", tuple(shuffled)),
        History("after others", forward, others_first=True),
        History("rebuilt at random", forward[1::2] + forward[::2], rebuilds=True),
    ]


def draw(tasks: list[str], policies: list[str], episodes: int, others: int) -> tuple[list[Case], list[Case]]:
    """The cases, and others that make history, of all tasks in turn."""
    simulator = Simulator()
    cases: list[Case] = []
    history: list[Case] = []
    for task in tasks:
        cases += draw_cases(task, policies, episodes, simulator)[0]
        history += draw_cases(task, ["near"], -(-others // len(tasks)), simulator, OTHERS_START)[0]
    simulator.close()
    random.Random(2).shuffle(history)
    return cases, history


def main() -> int:
    """Measure and print; the exit code is 6 if anything differs."""
    options = parser(__doc__)
    options.add_argument("--tasks", default=",".join(TASKS))
    options.add_argument("--policies", default=",".join(POLICIES))
    options.add_argument("--episodes", type=int, default=300, help="of each task (default 300)")
    options.add_argument("--others", type=int, default=2000, help="episodes run before, in one history (default 2000)")
    options.add_argument("--workers", type=int, default=2)
    arguments = options.parse_args()
    tasks, policies = arguments.tasks.split(","), arguments.policies.split(",")

    cases, others = draw(tasks, policies, arguments.episodes, arguments.others)
    compared = histories(len(cases))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cases.pickle"
        file.write_bytes(pickle.dumps((cases, others)))
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(arguments.workers, context, max_tasks_per_child=1) as pool:
            runs = list(pool.map(run_history, compared, [str(file)] * len(compared)))

    reference = runs[0]
    table = Table("history", "cases", "differences", "other labels", *tasks, title="same cases, other histories")
    found: dict[str, dict[str, int]] = {}
    total = 0
    examples = []
    for history, run in zip(compared[1:], runs[1:], strict=True):
        different = [n for n in range(len(cases)) if run[n][0] != reference[n][0]]
        labels = [n for n in different if run[n][1] != reference[n][1]]
        by_task = Counter(cases[n].situation.task for n in different)
        counts = [str(by_task[task]) for task in tasks]
        table.add_row(history.name, str(len(cases)), str(len(different)), str(len(labels)), *counts)
        found[history.name] = {"differences": len(different), "labels": len(labels), **by_task}
        total += len(different)
        examples += [(history.name, cases[n], reference[n][1], run[n][1]) for n in different[:3]]
    notes = [
        f"{name}: {case.situation.task} {case.policy} episode {case.episode} action {case.action}: {before} / {after}"
        for name, case, before, after in examples
    ]
    reached = target("bit-identical after any history", "0 differences", str(total), total == 0)
    numbers = {"cases": len(cases), "others": len(others), "histories": found}
    return finish(arguments, "determinism", [table], [reached], notes, numbers, mismatch=total > 0)


if __name__ == "__main__":
    sys.exit(main())
