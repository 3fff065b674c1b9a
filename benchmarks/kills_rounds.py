"""Kills a recursion at random moments with SIGKILL, runs it again until it is done, and compares every sealed byte.

    python benchmarks/kills_rounds.py                                   # 10 kills of rema-v1 at 1 % of its episodes
    python benchmarks/kills_rounds.py --kills 2 --percent 0.1 --updates 2

The plan is that of rema-v1 with its four rounds and the joint networks, a share of its episodes, small networks and few
updates. A run is killed and started again until it ends by itself, each time after a random time of up to that of an
undisturbed run: in turn the process alone (its simulators outlive it for a moment) and its whole group. Then another
one begins in a new folder; after the last kill it runs undisturbed. Compared are all files of all sealed releases, and
of the networks all but ``stages.json``, which has times. Exits with 6 if a file differs or is left behind. Cards name
the commit of the code, and releases the networks with their cards: leave the checkout as it is meanwhile.
"""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from baselines.rounds.sealed import STAGES
from benchmarks.results import ROOT, finish, parser, target
from benchmarks.signals import Verb, digests, listens, names, started, whole_run
from evaluator.run.environment import code_commit

PLAN = ROOT / "manifests" / "plans" / "rema-v1.toml"
NAME = "killed"
NETWORK = "[[rounds.networks]]"
SMALL = 'architecture = { width = 8 }\non_empty = "renormalise" # so few episodes may lack a success of some skill\n'


def scaled(text: str, percent: float, updates: int) -> str:
    """The text of a plan with a share of its episodes, and with small networks of all but single skills."""

    def share(found: re.Match[str]) -> str:
        return f"{found[1]} = {max(2, round(int(found[2]) * percent / 100))}"

    text = re.sub(r"\b(train|val) = (\d+)", share, text)
    text = re.sub(r"^updates = \d+", f"updates = {updates}", text, flags=re.MULTILINE)
    text = re.sub(r"^validate_every = \d+", f"validate_every = {max(1, updates // 2)}", text, flags=re.MULTILINE)
    text = re.sub(r"^policies = .*", "", text.replace(PLAN.stem, NAME), flags=re.MULTILINE)
    head, *networks = text.split(NETWORK)
    kept = [one for one in networks if 'network = "separate/' not in one]
    return head + "".join(NETWORK + re.sub(r"^(updates = )", rf"{SMALL}\1", one, flags=re.MULTILINE) for one in kept)


def kill_after(verb: Verb, folder: Path, life_s: float, group: bool) -> bool:
    """Whether a run was still working after some time, and was killed."""
    folder.mkdir(exist_ok=True)
    with started(verb, folder, subprocess.DEVNULL) as process:
        while process.poll() is None and not listens(process.pid):
            time.sleep(0.002)
        try:
            process.wait(life_s)
        except subprocess.TimeoutExpired:
            if group:
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
    return process.returncode == -signal.SIGKILL


def done(folder: Path) -> str:
    """What is sealed by now, in words."""
    releases = len(list(folder.glob("out/*/manifest.json")))
    return f"{releases} rounds, {len(list(folder.glob('out/checkpoints/*/*/*.safetensors')))} networks"


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--kills", type=int, default=10)
    options.add_argument("--percent", type=float, default=1.0, help="of the plan's episodes (default 1)")
    options.add_argument("--updates", type=int, default=30, help="of each network (default 30)")
    options.add_argument("--seed", type=int, default=1)
    arguments = options.parse_args()
    rng = random.Random(arguments.seed)
    rows: list[dict[str, Any]] = []
    runs: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="rema-kills-") as name:
        plan = Path(name) / "plan.toml"
        plan.write_text(scaled(PLAN.read_text(encoding="utf-8"), arguments.percent, arguments.updates))
        sealed = (f"out/{NAME}*/**/*", "out/checkpoints/**/*")
        verb = Verb(("rounds", str(plan), "--output", "out", "--workers", "2"), sealed)

        def compared(folder: Path) -> dict[str, str]:
            return {path: found for path, found in digests(verb, folder).items() if not path.endswith(STAGES)}

        commit, reference = code_commit(), Path(name) / "reference"
        seconds, failed = whole_run(verb, reference)
        if failed:
            raise SystemExit(f"the undisturbed run failed:\n{failed}")
        wanted, usual = compared(reference), names(reference / "out")
        while len(rows) < arguments.kills:
            folder, before = Path(name) / f"run-{len(runs)}", len(rows)
            while len(rows) < arguments.kills:
                life_s = rng.uniform(0, seconds)
                group = bool(len(rows) % 2)
                if not kill_after(verb, folder, life_s, group):
                    break  # it was done before
                what = "its group" if group else "the process"
                rows.append({"killed": what, "after_s": round(life_s, 1), "done": done(folder)})
                print(f"kill {len(rows)}: {rows[-1]}", file=sys.stderr, flush=True)
            _, failed = whole_run(verb, folder)
            found = {} if failed else compared(folder)
            different = sorted(path for path in {*wanted, *found} if wanted.get(path) != found.get(path))
            left = sorted(names(folder / "out") - usual)
            runs.append({"kills": len(rows) - before, "different": different, "left": left, "failed": failed[-2000:]})
        if code_commit() != commit:
            raise SystemExit("the checkout was changed meanwhile: the cards of the networks name another commit")
    table = Table("killed", "after, s", "sealed by then", title=f"rema-v1 at {arguments.percent:g} % of its episodes")
    for row in rows:
        table.add_row(row["killed"], f"{row['after_s']:.1f}", row["done"])
    same = sum(not one["different"] for one in runs)
    left = sum(bool(one["left"]) for one in runs)
    targets = [
        target(f"runs with the same bytes in {len(wanted)} files", str(len(runs)), str(same), same == len(runs)),
        target("runs that leave something behind", "0", str(left), left == 0),
    ]
    notes = [f"{len(rows)} kills; an undisturbed run took {seconds:.0f} s."]
    for one in runs:
        if one["different"] or one["left"]:
            print(one, file=sys.stderr)
    wrong = same < len(runs) or left > 0
    numbers = {"kills": rows, "runs": runs, "files": len(wanted), "seconds": seconds}
    return finish(arguments, "kills_rounds", [table], targets, notes, numbers, mismatch=wrong)


if __name__ == "__main__":
    sys.exit(main())
