"""Times the verification of an entry against the run that it was made of: both simulate the same actions.

    python benchmarks/verify_entry.py --check                          # scripted, grasp, 10,000 episodes
    python benchmarks/verify_entry.py --task push --episodes 500       # the first 500: of the run, as it is no entry

The run is a whole `rema evaluate` (observe, infer, simulate, audit), the verification what `rema leaderboard --verify`
does with its entry; both with the same number of processes, one after the other.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from evaluator.leaderboard.verification import verify
from evaluator.policy import resolve
from evaluator.run.entry import encode, read_entry
from evaluator.run.reading import read_run
from evaluator.runner import EvaluationConfig, run_evaluation
from rema_data.schema import TASKS

SLOWEST = 1.1
WHOLE = 10_000


def main() -> int:
    """Play, verify, compare."""
    options = parser(__doc__)
    options.add_argument("--policy", default="scripted")
    options.add_argument("--task", choices=TASKS, default="grasp")
    options.add_argument("--protocol", default="conditional")
    options.add_argument("--episodes", type=int, default=WHOLE)
    options.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory() as made:
        os.environ["REMA_HOME"] = str(Path(made) / "home")  # nothing is known, and nothing was observed before
        config = EvaluationConfig(
            resolve(arguments.policy),
            arguments.task,
            Path(made) / "run",
            protocol=arguments.protocol,
            episodes=arguments.episodes,
            workers=arguments.workers,
        )
        start = time.perf_counter()
        run_evaluation(config)
        played_s = time.perf_counter() - start
        run = read_run(config.output)
        path = Path(made) / "entry.json"
        whole = arguments.episodes == WHOLE
        if whole:
            path.write_bytes(encode(dataclasses.replace(run, kind_of_policy=run.tag)))
        start = time.perf_counter()
        found = verify(read_entry(path) if whole else read_run(config.output), workers=arguments.workers, again=True)
        verified_s = time.perf_counter() - start
        size = path.stat().st_size if whole else None
    same = found.counts == run.counts and found.verified == "here"
    ratio = verified_s / played_s
    table = Table(
        "episodes", "workers", "run, s", "verification, s", "ratio", "entry, bytes", title=f"{arguments.task}"
    )
    cells = [f"{arguments.episodes:,}", str(arguments.workers), f"{played_s:.1f}", f"{verified_s:.1f}", f"{ratio:.2f}"]
    table.add_row(*cells, "" if size is None else f"{size:,}")
    reached = target("verifying an entry", f"<= {SLOWEST} times its run", f"{ratio:.2f}", ratio <= SLOWEST)
    numbers = {"episodes": arguments.episodes, "played_s": played_s, "verified_s": verified_s, "ratio": ratio}
    return finish(arguments, "verify_entry", [table], [reached], [], {**numbers, "bytes": size}, mismatch=not same)


if __name__ == "__main__":
    sys.exit(main())
