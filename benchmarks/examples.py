"""The policies of examples/: what training them takes, and how they score on the validation lists, against random.

    python benchmarks/examples.py                                      # 500 scenarios a task
    python benchmarks/examples.py --episodes 50 --release rema-sample --batches 300
    python benchmarks/examples.py --page                               # docs/policies.md from the committed result

Trains with the examples' own scripts and scores with `rema evaluate`. Checkpoints that are in ``--output`` already are
kept, and runs there are continued. Needs scikit-learn (pip install scikit-learn).
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.report import measured
from benchmarks.results import RESULTS, ROOT, finish, parser, target

PAGE = ROOT / "docs" / "policies.md"
START = "<!-- examples: made by benchmarks/examples.py -->"
END = "<!-- end of examples -->"
TASKS = ("grasp", "push")
LEARNED = {"torch_policy": ("train", "weights.safetensors"), "sklearn_policy": ("sklearn_policy", "trees.joblib")}
"""Script that trains a policy, and its checkpoint."""
POLICIES = ("random", "my_policy", *LEARNED)
WANTED_TIMES, WANTED_S = 3.0, 240.0
"""How many times random's rate a learned policy reaches, and how many seconds of a core its training may take."""


def call(command: list[str]) -> tuple[str, float]:
    """What a command prints, and the seconds of a core that it takes."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def trained(policy: str, folder: Path, release: str, batches: int | None) -> dict[str, Any]:
    """The checkpoint of a policy, with the seconds of a core that its training took; trained where it is missing."""
    script, name = LEARNED[policy]
    record = folder / f"{policy}.json"
    if not record.exists():
        words = ["--batches", str(batches)] if batches is not None and policy == "torch_policy" else []
        words = [f"examples/{script}.py", "--release", release, *words, "--output", str(folder / name)]
        printed, seconds = call(words)
        bytes_ = (folder / name).stat().st_size
        auc = [line for line in printed.splitlines() if "AUC" in line]
        record.write_text(json.dumps({"seconds": round(seconds, 1), "bytes": bytes_, "validation": auc}))
    return {**json.loads(record.read_text()), "checkpoint": folder / name}


def score(policy: str, task: str, checkpoint: Path | None, folder: Path, episodes: int) -> dict[str, Any]:
    """Summary of a run on the validation list."""
    named = policy if policy == "random" else f"examples/{policy}.py"
    words = ["--checkpoint", str(checkpoint)] if checkpoint is not None else []
    words += ["--split", "val", "--episodes", str(episodes), "--workers", "1", "--json"]
    run = folder / f"{policy}-{task}"
    printed, _ = call(["-m", "evaluator.cli", "evaluate", named, "--task", task, *words, "--output", str(run)])
    summary = json.loads(printed)
    kept = ("successes", "eligible", "success_rate", "ci95", "failures", "policy_errors")
    return {name: summary[name] for name in kept}


def page(text: str) -> str:
    """``text`` with the committed result between its markers."""
    result = json.loads((RESULTS / "examples.json").read_text(encoding="utf-8"))
    (head, rest), lines = text.split(START), "\n".join(measured(result)).strip()
    return f"{head}{START}\n\n{lines}\n\n{END}{rest.split(END)[1]}"


def main() -> int:
    """Train, score and print."""
    options = parser(__doc__)
    options.add_argument("--episodes", type=int, default=500, help="scenarios of a task (default 500)")
    options.add_argument("--release", default="rema-mini")
    options.add_argument("--batches", type=int, help="of examples/train.py; by default its own")
    options.add_argument("--output", type=Path, default=Path("runs/examples"), help="folder of checkpoints and runs")
    options.add_argument("--page", action="store_true", help="only write the committed result into docs/policies.md")
    arguments = options.parse_args()
    if arguments.page:
        PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
        return 0
    folder = arguments.output.resolve()
    folder.mkdir(parents=True, exist_ok=True)

    trainings = {policy: trained(policy, folder, arguments.release, arguments.batches) for policy in LEARNED}
    found = {
        policy: {
            task: score(policy, task, trainings.get(policy, {}).get("checkpoint"), folder, arguments.episodes)
            for task in TASKS
        }
        for policy in POLICIES
    }

    scores = Table("policy", *TASKS, title="policies of examples/, % [95 %]")
    for policy, rates in found.items():
        scores.add_row(policy, *(shown(rates[task]) for task in TASKS))
    training = Table("policy", "seconds of a core", "checkpoint, MB", title="training")
    targets = []
    for policy, one in trainings.items():
        training.add_row(policy, f"{one['seconds']:.0f}", f"{one['bytes'] / 1e6:.1f}")
        targets.append(
            target(f"{policy}: training", f"<= {WANTED_S:.0f} s", f"{one['seconds']:.0f} s", one["seconds"] <= WANTED_S)
        )
        for task in TASKS:
            low, chance = found[policy][task]["ci95"][0], found["random"][task]["ci95"][1]
            seen = f"{low:.1%} against {chance:.1%}"
            what = f"{policy}, {task}: lower end of its interval against random's upper end"
            targets.append(target(what, f">= {WANTED_TIMES:.0f} times", seen, low >= WANTED_TIMES * chance))
    notes = [
        f"Trained on {arguments.release}; scored on {arguments.episodes:,} scenarios of the validation lists.",
        *(f"{policy}: {line}." for policy, one in trainings.items() for line in one["validation"]),
    ]
    numbers = {
        "release": arguments.release,
        "episodes": arguments.episodes,
        "training": {policy: {**one, "checkpoint": one["checkpoint"].name} for policy, one in trainings.items()},
        "scores": found,
    }
    return finish(arguments, "examples", [scores, training], targets, notes, numbers)


def shown(score: dict[str, Any]) -> str:
    """A rate with its interval, in per cent."""
    low, high = score["ci95"]
    return f"{100 * score['success_rate']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


if __name__ == "__main__":
    sys.exit(main())
