r"""Do builds of Bullet agree? Hashes outcomes in this interpreter, and compares them with those in other interpreters.

    python benchmarks/bullet_builds.py                                          # this interpreter's hashes
    python benchmarks/bullet_builds.py --against venv-3.12/bin/python venv-3.13/bin/python \
        --json benchmarks/results/bullet_builds.json
    python benchmarks/bullet_builds.py --page                                   # docs/install.md from that file

Every interpreter acts at the last step of the first test scenarios of a task, once as ``scripted`` and once as
``random`` would, and hashes action, outcome and the state in which the simulation ended: one different bit is a
difference. The interpreters run one after the other. Exits with 6 if one hash differs.
"""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.table import Table

from benchmarks.determinism import digest
from benchmarks.report import measured
from benchmarks.results import RESULTS, ROOT, finish, parser, target
from benchmarks.situations import Case, choose
from evaluator.scenarios import load_list
from evaluator.sim.bullet import bullet_version
from evaluator.sim.simulator import Simulator
from rema_data.schema import TASKS

PAGE = ROOT / "docs" / "install.md"
START = "<!-- builds: made by benchmarks/bullet_builds.py -->"
END = "<!-- end of builds -->"
POLICIES = ("scripted", "random")
SEED = 20211203


def hashes(outcomes: int) -> dict[str, Any]:
    """What this interpreter computes: its Python, its build of Bullet, and for each task one hash an outcome."""
    simulator = Simulator()
    tasks = {task: task_hashes(simulator, task, outcomes) for task in TASKS}
    simulator.close()
    return {"python": platform.python_version(), "build": bullet_version(), "tasks": tasks}


def task_hashes(simulator: Simulator, task: str, outcomes: int) -> list[str]:
    """Hashes of action, outcome and final state."""
    rng = np.random.default_rng(SEED)
    found = []
    for index, scenario in enumerate(load_list(task).scenarios[: -(-outcomes // len(POLICIES))]):
        situation = scenario.last_situation()
        for policy in POLICIES:
            case = Case(policy, index, situation, choose(policy, situation, rng, simulator.parameters))
            found.append(hashlib.sha256(f"{case.action} {digest(simulator, case)}".encode()).hexdigest())
    return found


def hashes_of(interpreter: str, outcomes: int) -> dict[str, Any]:
    """The same by another interpreter."""
    command = [interpreter, __file__, "--episodes", str(outcomes), "--hashes"]
    found: dict[str, Any] = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
    return found


def page(text: str) -> str:
    """``text`` with the lines between the markers made from the committed result."""
    head, rest = text.split(START)
    content = json.loads((RESULTS / "bullet_builds.json").read_text(encoding="utf-8"))
    lines = "\n".join(measured(content)).strip()
    return f"{head}{START}\n\n{lines}\n\n{END}{rest.split(END)[1]}"


def main() -> int:
    """Measure and print; the exit code is 6 if anything differs."""
    options = parser(__doc__)
    options.add_argument("--episodes", type=int, default=2000, help="outcomes of each task (default 2000)")
    options.add_argument("--against", nargs="+", default=[], metavar="PYTHON", help="interpreters to compare with")
    options.add_argument("--hashes", action="store_true", help="print every hash as JSON, and nothing else")
    options.add_argument("--page", action="store_true", help="only write the committed result into docs/install.md")
    arguments = options.parse_args()
    if arguments.page:
        PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
        return 0
    here = hashes(arguments.episodes)
    if arguments.hashes:
        print(json.dumps(here))
        return 0
    runs = [here, *(hashes_of(interpreter, arguments.episodes) for interpreter in arguments.against)]
    names = [f"{run['build']}, Python {run['python']}" for run in runs]

    table = Table("task", "outcomes", "sha256 of all outcomes", *(f"differ in {name}" for name in names[1:]))
    table.title = f"outcomes of {names[0]}, and how many differ elsewhere"
    counts = dict.fromkeys(names[1:], 0)
    sums = {}
    for task, expected in here["tasks"].items():
        sums[task] = hashlib.sha256("".join(expected).encode()).hexdigest()
        row = []
        for name, run in zip(names[1:], runs[1:], strict=True):
            different = sum(a != b for a, b in zip(expected, run["tasks"][task], strict=True))
            counts[name] += different
            row.append(str(different))
        table.add_row(task, f"{len(expected):,}", sums[task][:16], *row)
    total = sum(counts.values())
    reached = [target("bit-identical in every build", "0 differences", str(total), total == 0)] if counts else []
    numbers = {"reference": names[0], "outcomes": arguments.episodes, "sha256": sums, "differences": counts}
    return finish(arguments, "bullet_builds", [table], reached, [], numbers, mismatch=total > 0)


if __name__ == "__main__":
    sys.exit(main())
