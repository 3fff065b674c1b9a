"""Speed of the world on one core: episodes a second, cost of a step, share of Bullet; and a plain recipe beside it.

    python benchmarks/sim_throughput.py                                # all tasks, scripted, and the plain recipe
    python benchmarks/sim_throughput.py --policy random --tasks grasp,push --plain 0

An episode is one observation and one action, tools in hand. Its time is the wall time of both; ``stepping`` is the
share of it inside ``stepSimulation``. The plain recipe (``plain_recipe.py``) runs the same scripted grasps in the same
process, in turns with the world. Targets are for the scripted policy.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.plain_recipe import PlainOutcome, PlainRecipe
from benchmarks.results import finish, parser, target
from benchmarks.situations import POLICIES, Case, draw_cases
from evaluator.sim.footprints import hand_footprint
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.planar import gap
from evaluator.sim.shapes import footprint
from evaluator.sim.simulator import Simulator
from rema_data import grid
from rema_data.schema import TASKS, StepOutcome

WARM_UP = 10
STEPPING_SHARE = 0.85
OBSERVATION_SHARE = 0.05
PLAIN_RATIO = 20.0
GRAZING_MM = 3.0
"""Fingers that land on an object by less may be stopped by its edge or slip past it."""

clock = time.perf_counter


class StepClock:
    """Counts and times ``stepSimulation`` of a simulator, and times its rebuilds, by wrapping both calls."""

    def __init__(self, simulator: Simulator) -> None:
        self.seconds = 0.0
        self.steps = 0
        self.rebuilding_s = 0.0
        world = simulator.world
        world._step = self._timed(world._step)
        world.begin = self._timed_rebuild(world.begin)  # type: ignore[method-assign]

    def _timed(self, step: Callable[[], Any]) -> Callable[[], None]:
        def timed() -> None:
            start = clock()
            step()
            self.seconds += clock() - start
            self.steps += 1

        return timed

    def _timed_rebuild(self, begin: Callable[..., None]) -> Callable[..., None]:
        def timed(*arguments: Any) -> None:
            start = clock()
            begin(*arguments)
            self.rebuilding_s += clock() - start

        return timed


@dataclass(frozen=True, slots=True)
class Throughput:
    """Sums over the episodes of one repeat, seconds of wall time."""

    episodes: int
    simulated: int
    steps: int
    observing_s: float
    acting_s: float
    stepping_s: float
    rebuilding_s: float

    @property
    def total_s(self) -> float:
        """Observations and actions."""
        return self.observing_s + self.acting_s

    def row(self) -> dict[str, float]:
        """The derived numbers."""
        return {
            "episodes_per_second": self.episodes / self.total_s,
            "simulated_share": self.simulated / self.episodes,
            "steps_per_episode": self.steps / self.episodes,
            "microseconds_per_step": 1e6 * self.stepping_s / self.steps if self.steps else 0.0,
            "seconds_per_episode": self.total_s / self.episodes,
            "stepping_share": self.stepping_s / self.total_s,
            "rebuilding_share": self.rebuilding_s / self.total_s,
            "observation_ms": 1e3 * self.observing_s / self.episodes,
            "observation_share": self.observing_s / self.total_s,
        }


def measure(cases: list[Case], simulator: Simulator, steps: StepClock) -> Throughput:
    """One pass over the cases."""
    steps_before, stepping_before, rebuilding_before = steps.steps, steps.seconds, steps.rebuilding_s
    observing = acting = 0.0
    simulated = 0
    for case in cases:
        start = clock()
        observe(case.situation)
        middle = clock()
        outcome = simulator.run(case.situation, case.action)
        end = clock()
        observing += middle - start
        acting += end - middle
        simulated += outcome.sim_steps > 0
    return Throughput(
        len(cases),
        simulated,
        steps.steps - steps_before,
        observing,
        acting,
        steps.seconds - stepping_before,
        steps.rebuilding_s - rebuilding_before,
    )


def tasks_table(
    tasks: list[str], policy: str, episodes: int, repeats: int
) -> tuple[Table, dict[str, dict[str, float]]]:
    """Every task, the median of the repeats by episodes a second."""
    table = Table(
        "task", "episodes/s", "simulated", "steps/episode", "µs/step", "stepping", "rebuilding", "observing, ms",
        "observing", "±",
        title=f"{policy}, one core, {episodes} episodes, median of {repeats}",
    )  # fmt: skip
    rows: dict[str, dict[str, float]] = {}
    for task in tasks:
        simulator = Simulator()
        cases, _ = draw_cases(task, [policy], WARM_UP + episodes, simulator)
        steps = StepClock(simulator)
        measure(cases[:WARM_UP], simulator, steps)
        runs = sorted((measure(cases[WARM_UP:], simulator, steps) for _ in range(repeats)), key=lambda run: run.total_s)
        simulator.close()
        row = runs[len(runs) // 2].row()
        row["spread"] = runs[-1].total_s / runs[0].total_s - 1
        rows[task] = row
        table.add_row(
            task,
            f"{row['episodes_per_second']:.1f}",
            f"{row['simulated_share']:.0%}",
            f"{row['steps_per_episode']:.0f}",
            f"{row['microseconds_per_step']:.0f}",
            f"{row['stepping_share']:.1%}",
            f"{row['rebuilding_share']:.1%}",
            f"{row['observation_ms']:.2f}",
            f"{row['observation_share']:.1%}",
            f"{row['spread']:.0%}",
        )
    return table, rows


@dataclass(frozen=True, slots=True)
class Pair:
    """The same grasp by the world and by the plain recipe, and how long each took (s)."""

    case: Case
    ours: StepOutcome
    ours_s: float
    plain: PlainOutcome
    plain_s: float

    @property
    def labels(self) -> tuple[str, str]:
        """Labels of the world and of the plain recipe."""
        return str(self.ours.failure or "success"), str(self.plain.failure or "success")


def compare(episodes: int) -> list[Pair]:
    """Scripted grasps by both, in turns, after two of each to warm up."""
    simulator, recipe = Simulator(), PlainRecipe()
    cases, _ = draw_cases("grasp", ["scripted"], episodes + 2, simulator)
    pairs = []
    for case in cases:
        start = clock()
        observe(case.situation)
        ours = simulator.run(case.situation, case.action)
        middle = clock()
        plain = recipe.run(case.situation.target, case.action, ours.arm if ours.arm != "none" else "left")
        pairs.append(Pair(case, ours, middle - start, plain, clock() - middle))
    simulator.close()
    recipe.close()
    return pairs[2:]


def overlap_mm(case: Case) -> float:
    """How far the open fingers of a grasp reach over the object, seen from above; negative where they clear it."""
    x, y, yaw = (float(value) for value in grid.to_world(case.action))
    fingers = hand_footprint(WORLD.opening_max_m, None, WORLD)
    return -1e3 * gap([rect.moved(x, y, yaw) for rect in fingers], footprint(case.situation.target))


def plain_tables(pairs: list[Pair]) -> tuple[list[Table], dict[str, Any], list[str]]:
    """Speed of both, and their labels against each other."""
    ours_s, plain_s = sum(pair.ours_s for pair in pairs), sum(pair.plain_s for pair in pairs)
    ratios = [pair.plain_s / pair.ours_s for pair in pairs if pair.ours.success]
    counts = Counter(pair.labels for pair in pairs)
    different = [pair for pair in pairs if pair.labels[0] != pair.labels[1]]
    flips = [pair for pair in different if "success" in pair.labels]
    speed = Table(
        "recipe", "episodes/s", "s/episode", "steps/episode", "successes",
        title=f"the same {len(pairs)} scripted grasps, one core",
    )  # fmt: skip
    for name, seconds, steps, successes in (
        ("this world", ours_s, [pair.ours.sim_steps for pair in pairs], sum(pair.ours.success for pair in pairs)),
        ("plain", plain_s, [pair.plain.sim_steps for pair in pairs], sum(not pair.plain.failure for pair in pairs)),
    ):
        speed.add_row(
            name,
            f"{len(pairs) / seconds:.2f}",
            f"{seconds / len(pairs):.3f}",
            f"{statistics.mean(steps):.0f}",
            str(successes),
        )
    labels = Table("this world", "plain", "episodes", title="labels of both recipes")
    for (mine, other), count in counts.most_common():
        labels.add_row(mine, other, str(count))
    numbers = {
        "episodes": len(pairs),
        "ours_per_second": len(pairs) / ours_s,
        "plain_per_second": len(pairs) / plain_s,
        "ratio": plain_s / ours_s,
        "ratio_of_successes_median": statistics.median(ratios) if ratios else None,
        "label_differences": len(different),
        "success_flips": len(flips),
    }
    notes = [
        f"The two recipes disagree on success in {len(flips)} and on the label in {len(different)} of {len(pairs)} "
        "episodes."
    ]
    notes += [
        f"  episode {pair.case.episode}, {pair.case.situation.target.spec.shape}: {pair.labels[0]} (lift "
        f"{pair.ours.lift_m:.3f} m, descent force {pair.ours.peak_force_n:.0f} N) / {pair.labels[1]} "
        f"(lift {pair.plain.lift_m:.3f} m); open fingers over the object: {overlap_mm(pair.case):.1f} mm"
        for pair in different
    ]
    if different:
        grazing = sum(0 < overlap_mm(pair.case) < GRAZING_MM for pair in different)
        notes.append(f"{grazing} of {len(different)}: fingers descend on the object's edge by < {GRAZING_MM:.0f} mm.")
    return [speed, labels], numbers, notes


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--tasks", default=",".join(TASKS))
    options.add_argument("--policy", choices=POLICIES, default="scripted")
    options.add_argument("--episodes", type=int, default=200, help="of each task and repeat (default 200)")
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--plain", type=int, default=40, help="episodes of the plain recipe; 0 leaves it out")
    arguments = options.parse_args()

    table, rows = tasks_table(arguments.tasks.split(","), arguments.policy, arguments.episodes, arguments.repeats)
    tables = [table]
    notes = [
        "Rebuilding is the cost of determinism: the world is rebuilt for every step (docs/world.md). It takes about "
        "the same time in every task, so the shortest episodes, pushes, have the smallest share of stepping."
    ]
    numbers: dict[str, Any] = {"policy": arguments.policy, "tasks": rows}
    targets = []
    if arguments.policy == "scripted":
        seconds = sum(row["seconds_per_episode"] for row in rows.values())
        stepping = sum(row["seconds_per_episode"] * row["stepping_share"] for row in rows.values()) / seconds
        targets.append(
            target("all tasks: stepping", f">= {STEPPING_SHARE:.0%}", f"{stepping:.1%}", stepping >= STEPPING_SHARE)
        )
        for task, row in rows.items():
            share, seen = row["stepping_share"], row["observation_share"]
            targets.append(
                target(f"{task}: stepping", f">= {STEPPING_SHARE:.0%}", f"{share:.1%}", share >= STEPPING_SHARE)
            )
            targets.append(
                target(f"{task}: observing", f"<= {OBSERVATION_SHARE:.0%}", f"{seen:.1%}", seen <= OBSERVATION_SHARE)
            )
    if arguments.plain:
        more, numbers["plain"], found = plain_tables(compare(arguments.plain))
        notes += found
        tables += more
        ratio = numbers["plain"]["ratio"]
        targets.append(target("times the plain recipe", f">= {PLAIN_RATIO:.0f}", f"{ratio:.1f}", ratio >= PLAIN_RATIO))
    return finish(arguments, "sim_throughput", tables, targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
