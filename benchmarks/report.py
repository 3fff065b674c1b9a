"""Writes docs/performance.md from the JSON files of the other benchmarks: no number in it is typed.

    python benchmarks/report.py                                        # benchmarks/results/*.json
    python benchmarks/report.py --results FOLDER --output FILE

Each benchmark writes its file with ``--json benchmarks/results/NAME.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.results import RESULTS, ROOT
from rema_data.errors import MissingFileError, RemaError

SECTIONS = {
    "sim_throughput": "Speed of the world",
    "noise": "Observations with the noise of a camera",
    "full_run": "Whole runs",
    "report_page": "The report of a run",
    "view": "Browsing a release",
    "isolation": "Isolation of the policy",
    "verify_entry": "Verifying an entry of the leaderboard",
    "hostile": "Hostile policies",
    "forgeries": "Forged runs and entries",
    "memory": "Memory",
    "determinism": "Determinism of the world",
    "byte_identity": "Equal bytes of whole runs",
    "kills": "Killed and resumed runs",
    "kills_rounds": "Killed and resumed recursions",
    "mutations": "Mutated inputs",
    "signals": "Stopped verbs",
    "coverage": "Coverage of the statistics",
    "shortcuts": "The geometric shortcut",
    "read": "Training reads",
    "open": "Opening a release",
    "sampler": "The balanced sampler",
    "size": "Size of a release",
    "codecs": "Codecs of the maps",
    "download": "Download",
    "formats": "Exports and imports",
    "robomimic_reader": "Exported files in robomimic's own reader",
    "lerobot_reader": "Exported datasets in LeRobot's own reader",
    "minari_reader": "Exported datasets in Minari and its environments",
    "rlds_reader": "Exported datasets in TensorFlow Datasets",
    "hf_reader": "Exported datasets in Hugging Face datasets",
    "harness_lerobot": "The tasks in LeRobot",
    "harness_vla_eval": "The tasks in vla-evaluation-harness",
    "harness_inspect_robots": "The tasks in Inspect Robots",
    "train": "Training speed",
    "infer": "Inference speed",
    "half_precision": "Weights in half precision",
}
"""Sections, in this order; a benchmark may have several files."""


def load(folder: Path) -> list[dict[str, Any]]:
    """Contents of the result files, in the order of the sections and then of the file names.

    Raises
    ------
    MissingFileError
        There are none.
    """
    order = list(SECTIONS)
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    kept = [content for content in found if content.get("benchmark") in SECTIONS]
    if not kept:
        hint = "run one first: python benchmarks/sim_throughput.py --json benchmarks/results/sim_throughput.json"
        raise MissingFileError(f"there are no benchmark results in {folder}", hint=hint, path=str(folder))
    return sorted(kept, key=lambda content: order.index(content["benchmark"]))


def page(results: list[dict[str, Any]]) -> str:
    """The whole page, Markdown."""
    lines = [
        "# Performance",
        "",
        "Made by `python benchmarks/report.py` from the results of the benchmarks. Each section shows its command.",
        "",
        *_machines(results),
    ]
    title = ""
    for result in results:
        if SECTIONS[result["benchmark"]] != title:
            title = SECTIONS[result["benchmark"]]
            lines += ["", f"## {title}"]
        lines += measured(result)
    return "\n".join(lines) + "\n"


def measured(result: dict[str, Any]) -> list[str]:
    """What one benchmark found, with its command: tables, targets and notes, Markdown."""
    lines = ["", "```", result["command"], "```"]
    for table in result["tables"]:
        lines += ["", f"**{table['title'][:1].upper()}{table['title'][1:]}**", "", *_table(**table)]
    if result["targets"]:
        rows = [
            [row["what"], row["wanted"], row["measured"], "yes" if row["reached"] else "**no**"]
            for row in result["targets"]
        ]
        lines += ["", *_table("", ["what", "target", "measured", "met"], rows)]
    return lines + [f"\n{note.strip()}" for note in result["notes"]]


def _machines(results: list[dict[str, Any]]) -> list[str]:
    """One line for every machine and set of versions among the results, and the highest load."""
    lines = ["Machines:", ""]
    for result in results:
        machine = result["machine"]
        versions = {"Python": machine["python"], "pybullet": machine["pybullet"], "numpy": machine["numpy"]}
        installed = ", ".join(f"{name} {version}" for name, version in versions.items() if version is not None)
        cores = "1 core" if machine["cores"] == 1 else f"{machine['cores']} cores"
        line = f"- {machine['cpu']}, {cores}, {machine['system']}; {installed}."
        if line not in lines:
            lines.append(line)
    loads = [result["machine"]["load_average"] for result in results if result["machine"]["load_average"] is not None]
    if loads:
        lines.append(f"\nLoad average at the end of the benchmarks, including their own processes: up to {max(loads)}.")
    return lines


def _table(title: str, header: list[str], rows: list[list[str]]) -> list[str]:
    def line(cells: list[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(header), "|" + "---|" * len(header), *(line(row) for row in rows)]


def main() -> int:
    """Write the page; says where."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--results", type=Path, default=RESULTS)
    options.add_argument("--output", type=Path, default=ROOT / "docs" / "performance.md")
    arguments = options.parse_args()
    try:
        results = load(arguments.results)
    except RemaError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(page(results), encoding="utf-8")
    print(arguments.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
