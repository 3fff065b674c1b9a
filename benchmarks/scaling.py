"""What an episode costs with more workers, through Ray, and in shards; and whether all of them write the same bytes.

    python benchmarks/scaling.py                                       # 2,000 scripted episodes, 1 to 3 workers
    python benchmarks/scaling.py --address HOST:PORT --workers 1,32,256 --episodes 10000
    python benchmarks/scaling_report.py                                # then writes the numbers into docs/scaling.md

Every run is a process of its own over the frozen test list, without the audit at its end. Without ``--address`` the Ray
runs use a cluster of one-CPU machines that are processes of this one. Exits with 6 if two files differ.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.results import ROOT, finish, parser, target
from evaluator.runner.merge import merge_runs

RUN = """
import json, sys, time
from pathlib import Path
from evaluator.runner.shards import RunShard
from evaluator.policy import resolve
from evaluator.runner import EvaluationConfig, run_evaluation

task, policy, output, episodes, engine, workers, shard = sys.argv[1:]


class Clock:
    simulating, begin_s, evaluator_s = False, 0.0, 0.0

    def phase(self, name, total):
        self.simulating, self.begin_s = name == "simulate", time.process_time()

    def advance(self, n):
        if self.simulating:
            self.evaluator_s = time.process_time() - self.begin_s

    def note(self, text):
        pass


clock = Clock()
options = {"shard": RunShard.parse(shard)} if shard else {}
config = EvaluationConfig(resolve(policy), task, Path(output), episodes=int(episodes), engine=engine,
                          workers=int(workers), audit_share=0.0, **options)
run_evaluation(config, clock)
print(json.dumps(clock.evaluator_s))
"""
SHARDS = 3
SMALL = 4
"""A run of so many times fewer episodes tells what a run costs before its first one."""
MACHINE = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}


@dataclass(frozen=True, slots=True)
class Measured:
    """One run.

    Attributes
    ----------
    engine : str
    workers : int
    episodes : int
    observe_s, infer_s, simulate_s, total_s : float
        Wall time of the phases and of the run, starts of workers included.
    simulator_s : float
        Seconds inside simulators, over all workers.
    evaluator_s : float
        Processor seconds of the evaluator while it simulates: handing out, collecting and recording.
    sha256 : str
        Of ``results.parquet``.
    """

    engine: str
    workers: int
    episodes: int
    observe_s: float
    infer_s: float
    simulate_s: float
    total_s: float
    simulator_s: float
    evaluator_s: float
    sha256: str


def digest(folder: Path) -> str:
    """Of the table of a finished run."""
    return hashlib.sha256((folder / "results.parquet").read_bytes()).hexdigest()


def run(task: str, policy: str, folder: Path, episodes: int, engine: str, workers: int, shard: str = "") -> Measured:
    """An evaluation from the start, in a process of its own."""
    words = [sys.executable, "-c", RUN, task, policy, str(folder), str(episodes), engine, str(workers), shard]
    done = subprocess.run(
        words, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True, check=True
    )
    seconds = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["seconds"]
    inside = pq.read_table(folder / "timings.parquet", columns=["seconds"]).column(0).to_pylist()
    return Measured(
        engine,
        workers,
        len(inside),
        *(seconds[phase] for phase in ("observe", "infer", "simulate", "total")),
        simulator_s=round(sum(inside), 3),
        evaluator_s=round(float(done.stdout.splitlines()[-1]), 3),
        sha256=digest(folder),
    )


@contextmanager
def cluster(address: str | None, machines: int) -> Iterator[None]:
    """A Ray cluster under ``RAY_ADDRESS``: the one at ``address``, or one of so many small machines on this one."""
    if address is not None:
        os.environ["RAY_ADDRESS"] = address
        yield
        return
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    with tempfile.TemporaryDirectory(prefix="ray") as folder:
        os.environ["RAY_TMPDIR"] = folder
        from ray.cluster_utils import Cluster  # after its environment is set

        started = Cluster(initialize_head=True, head_node_args=MACHINE)
        for _ in range(machines - 1):
            started.add_node(**MACHINE)
        os.environ["RAY_ADDRESS"] = started.address
        try:
            yield
        finally:
            started.shutdown()


def in_shards(task: str, policy: str, folder: Path, episodes: int, count: int) -> tuple[float, str]:
    """Seconds of merging so many shards that were evaluated one after the other, and the digest."""
    parts = [folder / f"shard{number}" for number in range(1, count + 1)]
    for number, part in enumerate(parts, 1):
        run(task, policy, part, episodes, "process", 1, f"{number}/{count}")
    start = time.perf_counter()
    merge_runs(parts, folder / "merged")
    return time.perf_counter() - start, digest(folder / "merged")


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--task", default="grasp_push")
    options.add_argument("--policy", default="scripted")
    options.add_argument("--episodes", type=int, default=2000)
    options.add_argument("--workers", default="1,2,3")
    options.add_argument("--engines", default="process,ray")
    options.add_argument("--address", help="of a Ray cluster")
    arguments = options.parse_args()
    counts = [int(word) for word in arguments.workers.split(",")]
    engines = arguments.engines.split(",")
    notes = []
    if "ray" in engines and importlib.util.find_spec("ray") is None:
        engines.remove("ray")
        notes.append("Without the ray engine: Ray is not installed.")
    with tempfile.TemporaryDirectory(prefix="rema-scaling-") as name:
        folder = Path(name)
        os.environ["REMA_HOME"] = str(folder / "home")  # an empty bank: the first run pays for the observations

        def measure(run_name: str, episodes: int, engine: str, workers: int) -> Measured:
            return run(arguments.task, arguments.policy, folder / run_name, episodes, engine, workers)

        first = measure("first", arguments.episodes, "process", max(counts))
        found, small = [], []
        for engine in engines:
            with cluster(arguments.address, max(counts)) if engine == "ray" else nullcontext():
                small.append(measure(f"{engine}-small", arguments.episodes // SMALL, engine, counts[0]))
                found += [measure(f"{engine}{count}", arguments.episodes, engine, count) for count in counts]
        merge_s, merged = in_shards(arguments.task, arguments.policy, folder, arguments.episodes, SHARDS)
    table = Table(
        "engine", "workers", "simulate, s", "in simulators, ms/episode", "busy", "evaluator, ms/episode", "sha256",
        title=f"{arguments.episodes:,} {arguments.policy} episodes of {arguments.task}",
    )  # fmt: skip
    for one in found:
        table.add_row(
            one.engine,
            str(one.workers),
            f"{one.simulate_s:.1f}",
            f"{1e3 * one.simulator_s / one.episodes:.1f}",
            f"{one.simulator_s / (one.simulate_s * one.workers):.0%}",
            f"{1e3 * one.evaluator_s / one.episodes:.2f}",
            one.sha256[:16],
        )
    table.add_row(f"{SHARDS} shards, merged", "", "", "", "", "", merged[:16])
    digests = {one.sha256 for one in found} | {merged}
    notes += [
        "Busy: time inside simulators, divided by workers times the wall time of the phase (the start of the workers "
        "included). If there are more workers than free cores, they wait for each other, also inside simulators.",
        f"Merging {SHARDS} shards took {merge_s:.1f} s.",
    ]
    verdict = target("same bytes from every run", "1 digest", str(len(digests)), len(digests) == 1)
    numbers = {
        "task": arguments.task,
        "policy": arguments.policy,
        "episodes": arguments.episodes,
        "first": asdict(first),
        "small": [asdict(one) for one in small],
        "runs": [asdict(one) for one in found],
        "shards": SHARDS,
        "merge_s": round(merge_s, 3),
    }
    return finish(arguments, "scaling", [table], [verdict], notes, numbers, mismatch=len(digests) > 1)


if __name__ == "__main__":
    sys.exit(main())
