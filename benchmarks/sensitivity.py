"""How the random and scripted rates move when one constant of the world is changed alone.

    python benchmarks/sensitivity.py --json benchmarks/results/sensitivity.json

The settings are the knobs of the calibration; each line of the result is one ``calibrate.py --set`` run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.calibrate import measure
from evaluator.sim.parameters import WORLD, parameters_hash

SINGLE = ("grasp", "push", "grasp_push")
SETTINGS: tuple[tuple[dict[str, float], tuple[str, ...]], ...] = (
    ({}, (*SINGLE, "grasp_grasp")),
    ({"length_max_m": 0.14}, SINGLE),
    ({"width_max_m": 0.040}, ("grasp",)),
    ({"arm_ratio": 1.0}, SINGLE),
    ({"descend_speed_m_s": 0.25}, SINGLE),
    ({"finger_lateral_m": 0.016}, SINGLE),
    ({"grasp_spawn_half_m": 0.09}, ("grasp",)),
    ({"push_speed_m_s": 0.5}, ("push",)),
    ({"tool_push_speed_m_s": 1.0}, ("grasp_push",)),
    ({"scripted_push_offset_m": 0.11}, ("grasp_push",)),
    ({"table_friction": 0.8}, ("push", "grasp_push")),
    ({"pair_open_m": 0.050}, ("grasp_grasp",)),
    ({"object_friction": 0.50}, ("grasp_grasp",)),
    ({"pair_squeeze_n": 40.0}, ("grasp_grasp",)),
)


def main() -> None:
    """Measure every setting and print one line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    lines: list[dict[str, Any]] = []
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for changes, tasks in SETTINGS:
            parameters = dataclasses.replace(WORLD, **changes)
            rates: dict[str, float] = {}
            for task in tasks:
                for row in measure(task, arguments.episodes, parameters, pool):
                    rates[f"{row['policy']} {task}"] = row["rate"]
            name = ", ".join(f"{key} {getattr(WORLD, key):g} -> {value:g}" for key, value in changes.items())
            lines.append({"setting": name or "as calibrated", "rates": rates})
            print(name or "as calibrated", {key: round(value, 1) for key, value in rates.items()}, flush=True)
    if arguments.json:
        content = {"episodes": arguments.episodes, "parameters": parameters_hash(), "lines": lines}
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
