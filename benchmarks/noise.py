"""Speed of the observations of a suite on one core, axis by axis; and whether its maps are the frozen ones.

    python benchmarks/noise.py                        # grasp and push of hard-v1, validation lists
    python benchmarks/noise.py --check                # exits with 6 below 2,000 observations a second with noise

A camera with faults draws, blurs and rounds maps of 64 x 64 and 112 x 112 pixels for every scenario. Times are of the
processor, so that other work on the machine counts less. Every map is compared with the sha256 in its list.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rich.table import Table

from benchmarks.results import finish, parser, target
from evaluator.scenarios import load_list
from evaluator.sim.observation import observation_sha256, observe
from rema_data.schema import Situation

SUITE = "hard-v1"
NOISY = "sense"
TARGET = 2_000
"""Observations a second of one core, with the noise of a camera."""


def rate(situations: list[Situation], repeats: int) -> float:
    """Observations a second of processor time: the median of the repeats, after some to warm up."""
    for situation in situations[:50]:
        observe(situation)
    found = []
    for _ in range(repeats):
        start = time.process_time()
        for situation in situations:
            observe(situation)
        found.append(len(situations) / (time.process_time() - start))
    return statistics.median(found)


def main() -> int:
    """Measure every axis of every task; the exit code."""
    made = parser(__doc__)
    made.add_argument("--tasks", default="grasp,push", help="separated by commas")
    made.add_argument("--split", choices=("val", "test"), default="val")
    made.add_argument("--count", type=int, default=300, help="observations of each axis")
    made.add_argument("--repeats", type=int, default=5)
    arguments = made.parse_args()
    table = Table("task", "axis", "observations/s", "other maps", title=f"observations of {SUITE}, one core")
    rows: dict[str, dict[str, Any]] = {}
    others = 0
    for task in arguments.tasks.split(","):
        axes: defaultdict[str, list[tuple[Situation, str]]] = defaultdict(list)
        for scenario in load_list(task, arguments.split, SUITE).scenarios:
            if (variation := scenario.variation) is not None and len(axes[variation.axis]) < arguments.count:
                axes[variation.axis].append((scenario.last_situation(), variation.seen))
        for axis, own in sorted(axes.items()):
            wrong = sum(observation_sha256(observe(situation)) != seen for situation, seen in own)
            speed = rate([situation for situation, _ in own], arguments.repeats)
            others += wrong
            rows[f"{task} {axis}"] = {"observations_per_second": speed, "observations": len(own), "other_maps": wrong}
            table.add_row(task, axis, f"{speed:,.0f}", str(wrong))
    noisy = {name: row["observations_per_second"] for name, row in rows.items() if name.endswith(f" {NOISY}")}
    targets = [
        target(f"{name}, observations a second of one core", f"at least {TARGET:,}", f"{speed:,.0f}", speed >= TARGET)
        for name, speed in noisy.items()
    ]
    return finish(arguments, "noise", [table], targets, [], {"axes": rows}, mismatch=bool(others))


if __name__ == "__main__":
    sys.exit(main())
