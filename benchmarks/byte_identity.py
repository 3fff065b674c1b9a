"""Compares results.parquet of runs with other workers, orders and engines, and of one that was killed and resumed.

    python benchmarks/byte_identity.py                                 # 200 scripted episodes of every task
    python benchmarks/byte_identity.py --tasks grasp --episodes 1000

Every run is a process of its own over the frozen test list. Exits with 6 if two files of a task differ.
"""

from __future__ import annotations

import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import ROOT, finish, parser, target
from rema_data.schema import TASKS

RUN = """
import sys
from pathlib import Path
from evaluator.policy import resolve
from evaluator.runner import EvaluationConfig, run_evaluation
task, output, episodes, workers, order, engine = sys.argv[1:]
run_evaluation(EvaluationConfig(resolve("scripted"), task, Path(output), episodes=int(episodes), workers=int(workers),
                                order=order, engine=engine))
"""
VARIANTS = (
    ("inline, forward", 1, "forward", "inline"),
    ("1 worker", 1, "shuffled", "process"),
    ("2 workers", 2, "shuffled", "process"),
    ("3 workers", 3, "shuffled", "process"),
    ("2 workers, reverse", 2, "reverse", "process"),
)
KILLED = "2 workers, killed and resumed"


def start(task: str, output: Path, episodes: int, workers: int, order: str, engine: str) -> subprocess.Popen[bytes]:
    """A run in a process of its own."""
    words = [sys.executable, "-c", RUN, task, str(output), str(episodes), str(workers), order, engine]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(words, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def digest(output: Path) -> str:
    """Of the table of a finished run."""
    return hashlib.sha256((output / "results.parquet").read_bytes()).hexdigest()


def killed(task: str, output: Path, episodes: int, rng: random.Random) -> tuple[str, int]:
    """Digest of a run that was killed after a random number of outcomes and resumed, and that number."""
    journal = output / "records" / "outcomes-0001.jsonl"
    stop = rng.randrange(1, max(2, episodes // 2))
    with start(task, output, episodes, 2, "shuffled", "process") as run:
        while run.poll() is None and not (journal.exists() and journal.read_bytes().count(b"\n") >= stop):
            time.sleep(0.002)
        run.send_signal(signal.SIGKILL)
    if start(task, output, episodes, 2, "shuffled", "process").wait():
        raise SystemExit(f"the killed run of {task} could not be resumed")
    return digest(output), stop


def main() -> int:
    """Compare and print."""
    options = parser(__doc__)
    options.add_argument("--tasks", default=",".join(TASKS))
    options.add_argument("--episodes", type=int, default=200)
    arguments = options.parse_args()
    rng = random.Random(3)
    table = Table("task", "run", "sha256 of results.parquet", title=f"scripted, {arguments.episodes} episodes a run")
    found: dict[str, dict[str, str]] = {}
    for task in arguments.tasks.split(","):
        with tempfile.TemporaryDirectory(prefix="rema-bytes-") as folder:
            digests: dict[str, str] = {}
            for number, (name, workers, order, engine) in enumerate(VARIANTS):
                output = Path(folder) / str(number)
                if start(task, output, arguments.episodes, workers, order, engine).wait():
                    raise SystemExit(f"the run {name} of {task} failed")
                digests[name] = digest(output)
            digests[KILLED], stop = killed(task, Path(folder) / "killed", arguments.episodes, rng)
        for name, value in digests.items():
            table.add_row(task, f"{name} after {stop} outcomes" if name == KILLED else name, value[:16])
        found[task] = digests
    same = [task for task, digests in found.items() if len(set(digests.values())) == 1]
    verdict = target("tasks with one digest", str(len(found)), str(len(same)), len(same) == len(found))
    return finish(arguments, "byte_identity", [table], [verdict], [], found, mismatch=len(same) < len(found))


if __name__ == "__main__":
    sys.exit(main())
