"""Kills runs at random moments with SIGKILL, resumes them, and compares their bytes and the work that was done twice.

    python benchmarks/kills.py                                  # 20 kills of random, grasp, 10,000 episodes
    python benchmarks/kills.py --kills 3 --episodes 200 --batch-size 2

In turn the evaluator itself, one of its simulation workers and the policy's process are killed, at a moment drawn from
those at which an undisturbed run had such a process. A run that did not survive is started again. Every run has a cache
of its own. Simulated episodes and questions to the policy are counted as they begin, those of the audit too, so that
work which was lost before it was recorded counts as repeated. Exits with 6 if a file differs.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import psutil
from rich.table import Table

from benchmarks.results import ROOT, finish, parser, target
from evaluator.policy import resolve
from evaluator.runner import EvaluationConfig, default_backend, run_evaluation
from evaluator.sim.simulator import Simulator
from rema_data.schema import Situation, StepOutcome

SIMULATED, ASKED = "simulated", "asked"
COUNTS = "REMA_KILLS_COUNTS"
"""Folder of two files, one byte for every episode that was begun to be simulated and for every question."""
FILES = ("results.parquet", "actions.bin")
VICTIMS = {"evaluator": "", "worker": "evaluator/engines/", "policy": "evaluator/policy/"}
"""What is killed, and the folder of its module, by which its command line is recognised."""
REPEATED = 0.02
POLL_S = 0.005
STARTS = 5
RUN = "import sys; from benchmarks.kills import counted_run; counted_run(*sys.argv[1:])"


def count(what: str, number: int) -> None:
    """Note so many of something, in a way that a kill cannot undo."""
    descriptor = os.open(Path(os.environ[COUNTS]) / what, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    os.write(descriptor, b"." * number)
    os.close(descriptor)


class CountingSimulator(Simulator):
    """The world, which counts what it is asked to do."""

    def run(self, situation: Situation, action: int) -> StepOutcome:
        """Outcome of one action."""
        count(SIMULATED, 1)
        return super().run(situation, action)


class CountingPolicy:
    """A policy's host, which counts observations; those of a batch that lost its process are asked once more."""

    def __init__(self, host: Any) -> None:
        self._host = host
        self.privileged = host.privileged

    def act(self, batch: Any, situations: tuple[Situation, ...] | None) -> Any:
        """One answer an observation."""
        before = self._host.restarts
        count(ASKED, len(batch))
        answers = self._host.act(batch, situations)
        if self._host.restarts > before:
            count(ASKED, len(batch))
        return answers


def counted_run(policy: str, task: str, output: str, episodes: str, batch_size: str) -> None:
    """A run in this process whose work is counted."""
    real = default_backend()

    @contextlib.contextmanager
    def open_policy(*arguments: Any) -> Iterator[CountingPolicy]:
        with real.open_policy(*arguments) as host:
            yield CountingPolicy(host)

    backend = dataclasses.replace(real, simulator="benchmarks.kills:CountingSimulator", open_policy=open_policy)
    config = EvaluationConfig(
        resolve(policy), task, Path(output), episodes=int(episodes), batch_size=int(batch_size), workers=2
    )
    run_evaluation(config, backend=backend)


@dataclass(frozen=True, slots=True)
class Setting:
    """What all runs have in common."""

    policy: str
    task: str
    episodes: int
    batch_size: int

    def start(self, folder: Path) -> subprocess.Popen[bytes]:
        """The run in a folder, begun or resumed."""
        (folder / "counts").mkdir(parents=True, exist_ok=True)
        words = [self.policy, self.task, str(folder / "run"), str(self.episodes), str(self.batch_size)]
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "REMA_HOME": str(folder / "home"),
            COUNTS: str(folder / "counts"),
        }
        quiet = subprocess.DEVNULL
        return subprocess.Popen(
            [sys.executable, "-c", RUN, *words], cwd=ROOT, env=environment, stdout=quiet, stderr=quiet
        )


def processes(run: subprocess.Popen[bytes], victim: str) -> list[psutil.Process]:
    """Processes of a run that are of one kind."""
    found = []
    with contextlib.suppress(psutil.Error):
        evaluator = psutil.Process(run.pid)
        if victim == "evaluator":
            return [evaluator]
        for child in evaluator.children(recursive=True):
            with contextlib.suppress(psutil.Error):
                if (
                    VICTIMS[victim] in " ".join(child.cmdline()).replace(".", "/")
                    and child.status() != psutil.STATUS_ZOMBIE
                ):
                    found.append(child)
    return found


def watch(setting: Setting, folder: Path) -> dict[str, list[float]]:
    """Moments of an undisturbed run at which there was a process of each kind, seconds from its start."""
    moments: dict[str, list[float]] = {victim: [] for victim in VICTIMS}
    start = time.monotonic()
    with setting.start(folder) as run:
        while run.poll() is None:
            for victim in VICTIMS:
                if processes(run, victim):
                    moments[victim].append(time.monotonic() - start)
            time.sleep(POLL_S)
    if run.returncode:
        raise SystemExit(f"the undisturbed run ended with {run.returncode}")
    return moments


def kill_and_resume(setting: Setting, folder: Path, victim: str, moment_s: float) -> tuple[bool, int]:
    """Whether a process was killed at (or first after) the moment, and how often the run had to be started."""
    killed = False
    start = time.monotonic()
    with setting.start(folder) as run:
        while run.poll() is None and not killed:
            late = time.monotonic() - start >= moment_s
            for process in processes(run, victim)[:1] if late else []:
                with contextlib.suppress(psutil.Error):
                    process.send_signal(signal.SIGKILL)
                    killed = True
            time.sleep(POLL_S)
    for starts in range(1, STARTS):
        if run.returncode == 0:
            return killed, starts
        run = setting.start(folder)
        run.wait()
    raise SystemExit(f"a run whose {victim} was killed after {moment_s:.1f} s could not be resumed")


def digests(folder: Path) -> dict[str, str]:
    """Of the files that must not differ."""
    return {name: hashlib.sha256((folder / "run" / name).read_bytes()).hexdigest() for name in FILES}


def counts(folder: Path) -> dict[str, int]:
    """How much was begun."""
    return {what: (folder / "counts" / what).stat().st_size for what in (SIMULATED, ASKED)}


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--policy", default="random")
    options.add_argument("--task", default="grasp")
    options.add_argument("--episodes", type=int, default=10_000)
    options.add_argument("--batch-size", type=int, default=64)
    options.add_argument("--kills", type=int, default=20)
    options.add_argument("--seed", type=int, default=1)
    arguments = options.parse_args()
    setting = Setting(arguments.policy, arguments.task, arguments.episodes, arguments.batch_size)
    rng = random.Random(arguments.seed)
    table = Table("killed", "after, s", "starts", "same bytes", "asked again", "simulated again", title="kills")
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="rema-kills-") as name:
        reference = Path(name) / "reference"
        moments = watch(setting, reference)
        wanted, done = digests(reference), counts(reference)
        while len(rows) < arguments.kills:
            victim = list(VICTIMS)[len(rows) % len(VICTIMS)]
            moment_s = rng.choice(moments[victim])
            with tempfile.TemporaryDirectory(prefix="rema-kill-", dir=name) as folder:
                killed, starts = kill_and_resume(setting, Path(folder), victim, moment_s)
                if not killed:
                    continue  # this run was quicker than the one that was watched
                same = digests(Path(folder)) == wanted
                again = {what: number - done[what] for what, number in counts(Path(folder)).items()}
            share = max(again.values()) / setting.episodes
            rows.append({"victim": victim, "moment_s": round(moment_s, 2), "starts": starts, "same": same,
                         "repeated": round(share, 5), **again})  # fmt: skip
            shown = (f"{100 * again[what] / setting.episodes:.2f} %" for what in (ASKED, SIMULATED))
            table.add_row(victim, f"{moment_s:.1f}", str(starts), "yes" if same else "NO", *shown)
    table.title = f"{setting.policy}, {setting.task}, {setting.episodes:,} episodes, batches of {setting.batch_size}"
    equal = sum(row["same"] for row in rows)
    most = max(row["repeated"] for row in rows)
    targets = [
        target("runs with the same bytes", str(len(rows)), str(equal), equal == len(rows)),
        target("most repeated by a kill", f"< {REPEATED:.0%} of the episodes", f"{most:.2%}", most < REPEATED),
    ]
    numbers = {"reference": done, "files": wanted, "kills": rows}
    return finish(arguments, "kills", [table], targets, [], numbers, mismatch=equal < len(rows))


if __name__ == "__main__":
    sys.exit(main())
