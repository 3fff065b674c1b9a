"""Write the tables of docs/calibration.md from result files and run folders.

    python benchmarks/calibrate.py --json benchmarks/results/calibration.json
    python benchmarks/sensitivity.py --json benchmarks/results/sensitivity.json
    python benchmarks/calibration_report.py --runs runs/*      # copies the runs' summaries to benchmarks/results/runs/

Only what stands between the markers of the page is replaced; without ``--runs`` the copied summaries are used.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.calibrate import PUBLISHED_TASKS, markdown, published_percent
from benchmarks.kept_runs import keep, kept_runs
from benchmarks.results import RESULTS, ROOT
from rema_data.schema import TASKS

PAGE = ROOT / "docs" / "calibration.md"


def replace_block(text: str, name: str, content: str) -> str:
    """``text`` with the lines between the markers of a block replaced."""
    start, end = f"<!-- {name}: made by benchmarks/calibration_report.py -->", f"<!-- end of {name} -->"
    head, found, rest = text.partition(start)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"the page has no block {name!r}")
    return f"{head}{start}\n\n{content}\n\n{end}{tail}"


def runs_table(summaries: list[dict[str, Any]]) -> str:
    """One row a run, ours beside the paper's."""
    lines = [
        "| task | policy | k / n | ours, % | 95 % | paper, % | failures, % of episodes |",
        "|---|---|---|---|---|---|---|",
    ]
    order = list(TASKS)
    for run in sorted(summaries, key=lambda run: (order.index(run["task"]), run["policy"])):
        low, high = run["ci95"]
        paper = published_percent(run["policy"], run["task"])
        labels = sorted(run["failures"].items(), key=lambda item: -item[1])
        failures = ", ".join(f"{label} {100 * count / run['eligible']:.1f}" for label, count in labels)
        lines.append(
            f"| {run['task']} | {run['policy']} | {run['successes']} / {run['eligible']} "
            f"| {100 * run['success_rate']:.2f} | {100 * low:.1f} to {100 * high:.1f} "
            f"| {'-' if paper is None else f'{paper:.2f}'} | {failures} |"
        )
    return "\n".join(lines)


def knobs_table(content: dict[str, Any]) -> str:
    """One row a changed constant: the difference that it makes, in points."""
    columns = [f"{policy} {task}" for task in PUBLISHED_TASKS for policy in ("random", "scripted")]
    base = content["lines"][0]["rates"]
    lines = ["| changed constant | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines.append("| as calibrated, % | " + " | ".join(f"{base[column]:.1f}" for column in columns) + " |")
    for line in content["lines"][1:]:
        cells = [f"{line['rates'][c] - base[c]:+.1f}" if c in line["rates"] else "" for c in columns]
        lines.append(f"| {line['setting']} | " + " | ".join(cells) + " |")
    n = content["episodes"]
    noise = [196 * (2 * rate * (1 - rate) / n) ** 0.5 for rate in (0.5, 0.05)]
    lines += [
        "",
        f"Each cell has {n} episodes. For independent episodes, differences below {noise[0]:.0f} points near 50 % and "
        f"{noise[1]:.0f} near 5 % would be noise; equal seeds make the comparison a little more precise.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Replace the blocks of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", nargs="*", type=Path, default=[])
    parser.add_argument("--page", type=Path, default=PAGE)
    arguments = parser.parse_args()
    keep(arguments.runs)
    text = arguments.page.read_text(encoding="utf-8")
    calibration = json.loads((RESULTS / "calibration.json").read_text(encoding="utf-8"))
    text = replace_block(text, "calibration", markdown(calibration["rows"]))
    conditional = [
        run
        for run in kept_runs().values()
        if run["protocol"] == "conditional" and run["policy"] in ("random", "scripted")
    ]
    text = replace_block(text, "runs", runs_table(conditional))
    sensitivity = RESULTS / "sensitivity.json"
    if sensitivity.exists():
        text = replace_block(text, "knobs", knobs_table(json.loads(sensitivity.read_text(encoding="utf-8"))))
    arguments.page.write_text(text, encoding="utf-8")
    print(arguments.page)


if __name__ == "__main__":
    main()
