"""What it costs to keep a policy apart: the questions of a whole run asked in three ways, as a share of that run.

    python benchmarks/isolation.py                                     # runs 10,000 episodes of the random policy first
    python benchmarks/isolation.py --run runs/random-grasp-conditional # or takes the seconds of a finished run

The policy is asked about as many observations as the run has episodes: in this process, with nothing between; in a
process of its own (level L1); and in the kernel's sandbox (L2, or what this machine reaches). Start and end of the
process count. The ways take turns. The observations are those of some scenarios, over and over.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.table import Table

from baselines.random_policy import RandomPolicy
from benchmarks.results import finish, parser, target
from evaluator.policy import ObservationBatch, PolicyHost, resolve
from evaluator.policy.faults import check_answer
from evaluator.runner import EvaluationConfig, run_evaluation
from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.reach import valid_actions
from rema_data.errors import MissingFileError

TASK = "grasp"
BATCH = 64
WANTED_SHARE = 0.05
DIRECT, PROCESS, SANDBOX = "in this process", "own process", "in the sandbox"


def questions(distinct: int, episodes: int) -> list[ObservationBatch]:
    """Batches of ``episodes`` observations in all, of ``distinct`` scenarios."""
    situations = [scenario.last_situation() for scenario in load_list(TASK, "val").scenarios[:distinct]]
    seen = [observe(situation) for situation in situations]
    scenes, hands = np.stack([one.scene_m() for one in seen]), np.stack([one.end_effector() for one in seen])
    kind, valid = situations[0].kind, valid_actions(TASK, 0)
    rows = np.array(list(islice(cycle(range(distinct)), episodes)))
    return [
        ObservationBatch(
            scenes[part],
            hands[part],
            kind.primitive.value,
            kind.embodiment.value,
            TASK,
            0,
            np.broadcast_to(valid, (len(part), *valid.shape)),
        )
        for part in np.split(rows, range(BATCH, episodes, BATCH))
    ]


def seconds_direct(asked: list[ObservationBatch]) -> float:
    """Asked with nothing between."""
    began = time.perf_counter()
    policy = RandomPolicy()
    for batch in asked:
        check_answer(policy.act(batch), batch.valid)
    return time.perf_counter() - began


def seconds_hosted(asked: list[ObservationBatch], confine: bool) -> tuple[float, str]:
    """Asked in a process of its own; with the level that it reached."""
    began = time.perf_counter()
    with PolicyHost(resolve("random"), None, confine=confine) as host:
        level = host.isolation.level
        for batch in asked:
            host.act(batch)
    return time.perf_counter() - began, level


def measure(asked: list[ObservationBatch], repeats: int) -> tuple[dict[str, list[float]], str]:
    """Seconds of every way, in turns; and the level in the sandbox."""
    seconds: dict[str, list[float]] = {DIRECT: [], PROCESS: [], SANDBOX: []}
    level = ""
    ways: dict[str, Callable[[], tuple[float, str]]] = {
        DIRECT: lambda: (seconds_direct(asked), "L0"),
        PROCESS: lambda: seconds_hosted(asked, confine=False),
        SANDBOX: lambda: seconds_hosted(asked, confine=True),
    }
    for _ in range(repeats):
        for name, way in ways.items():
            took, level = way()
            seconds[name].append(took)
    return seconds, level


def run_seconds(folder: Path | None, episodes: int) -> tuple[float, int]:
    """Seconds and episodes of a finished run, or of a new one.

    Raises
    ------
    MissingFileError
        There is no finished run in the folder.
    """
    with tempfile.TemporaryDirectory() as temporary:
        if folder is None:
            folder = Path(temporary, "run")
            run_evaluation(EvaluationConfig(resolve("random"), TASK, folder, episodes=episodes))
        path = folder / "summary.json"
        if not path.is_file():
            raise MissingFileError(f"{folder} holds no finished run", hint="give the folder of a run that has ended")
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return float(summary["seconds"]["total"]), int(summary["episodes"])


def main() -> int:
    """Run, measure and print."""
    options = parser(__doc__)
    options.add_argument("--episodes", type=int, default=10_000, help="of the run, if it is a new one")
    options.add_argument("--run", type=Path, metavar="FOLDER", help="a finished run of the random policy")
    options.add_argument("--distinct", type=int, default=512, help="different observations (default 512)")
    options.add_argument("--repeats", type=int, default=5)
    arguments = options.parse_args()
    total_s, episodes = run_seconds(arguments.run, arguments.episodes)
    seconds, level = measure(questions(arguments.distinct, episodes), arguments.repeats)
    middle = {name: median(values) for name, values in seconds.items()}
    table = Table(
        "way", "seconds", "least", "most", "share of the run", title=f"asking about {episodes:,} observations"
    )
    for name, values in seconds.items():
        extra = (middle[name] - middle[DIRECT]) / total_s
        table.add_row(name, f"{middle[name]:.2f}", f"{min(values):.2f}", f"{max(values):.2f}", f"{extra:+.2%}")
    cost = (middle[SANDBOX] - middle[DIRECT]) / total_s
    targets = [
        target("isolation, of a run of the random policy", f"< {WANTED_SHARE:.0%}", f"{cost:.2%}", cost < WANTED_SHARE)
    ]
    notes = [
        f"Medians of {arguments.repeats}. The run took {total_s:.1f} s; a share is the extra time compared with asking "
        f"in this process. The isolation level in the sandbox was {level}.",
    ]
    numbers = {"run_s": total_s, "episodes": episodes, "seconds": seconds, "level": level, "share": cost}
    return finish(arguments, "isolation", [table], targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
