"""Writes the numbers of docs/scaling.md from the result of benchmarks/scaling.py.

    python benchmarks/scaling.py --json benchmarks/results/scaling.json
    python benchmarks/scaling_report.py

Only what stands between the markers of the page is replaced. Without a result the page says how to get one.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.results import RESULTS, ROOT

PAGE = ROOT / "docs" / "scaling.md"
RESULT = RESULTS / "scaling.json"
EPISODES = 10_000_000
NODES = 100
CORES = (8, 32, 64)
"""Of a node."""
ABSENT = (
    "Not measured yet: `python benchmarks/scaling.py --json benchmarks/results/scaling.json`, then "
    "`python benchmarks/scaling_report.py`."
)


def replace_block(text: str, name: str, content: str) -> str:
    """``text`` with the lines between the markers of a block replaced."""
    start, end = f"<!-- {name}: made by benchmarks/scaling_report.py -->", f"<!-- end of {name} -->"
    head, found, rest = text.partition(start)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"the page has no block {name!r}")
    return f"{head}{start}\n\n{content}\n\n{end}{tail}"


def table(header: list[str], rows: list[list[str]]) -> str:
    """Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def measured(content: dict[str, Any]) -> str:
    """The tables of the benchmark, with its command and machine."""
    machine = content["machine"]
    parts = [f"```\n{content['command']}\n```"]
    parts += [table(found["header"], found["rows"]) for found in content["tables"]]
    verdict = content["targets"][0]
    parts.append(f"{verdict['what'].capitalize()}: {'yes' if verdict['reached'] else '**no**'}.")
    parts += content["notes"]
    parts.append(f"{machine['cpu']}, {machine['cores']} cores, load average {machine['load_average']} at the end.")
    return "\n\n".join(parts)


def paper(content: dict[str, Any]) -> str:
    """What ten million episodes would take on a hundred nodes, by the cost of an episode alone."""
    numbers = content["numbers"]
    runs, first = numbers["runs"], numbers["first"]

    def each(engine: str, *fields: str) -> float:
        """Seconds of an episode, without what a run costs before its first one."""
        small = next(run for run in numbers["small"] if run["engine"] == engine)
        large = next(run for run in runs if run["engine"] == engine and run["workers"] == small["workers"])
        more = sum(large[field] - small[field] for field in fields) / (large["episodes"] - small["episodes"])
        return max(0.0, float(more))

    core_s = each("process", "simulator_s")
    record_s = each(numbers["small"][-1]["engine"], "evaluator_s")
    before_s = first["observe_s"] / first["episodes"] + each("process", "infer_s")
    after_s = max(0.0, each("process", "total_s") - each("process", "observe_s", "infer_s", "simulate_s"))
    merge_s = numbers["merge_s"] / first["episodes"]
    rows = []
    for cores in CORES:
        everywhere = EPISODES * core_s / (NODES * cores)
        single, divided = (
            count * (before_s + after_s) + max(everywhere, count * record_s) for count in (EPISODES, EPISODES / NODES)
        )
        rows.append([str(cores), *map(hours, (everywhere, single, divided, divided + EPISODES * merge_s))])
    header = ["cores a node", "simulation alone", "one run through Ray", f"{NODES} shards", "and merged"]
    return "\n\n".join(
        [
            table(header, rows),
            f"An episode of {numbers['task']} takes {1e3 * core_s:.1f} ms of a core in the simulator. It takes the "
            f"evaluator {1e3 * before_s:.2f} ms to observe and infer, {1e3 * record_s:.2f} ms to hand out and record, "
            f"{1e3 * after_s:.2f} ms for the tables, and {1e3 * merge_s:.2f} ms to merge (its start included). The "
            "cost of a run before its first episode is not included.",
        ]
    )


def hours(seconds: float) -> str:
    """A duration in words."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"


def main() -> int:
    """Replace the blocks of the page; says which page."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--result", type=Path, default=RESULT)
    options.add_argument("--page", type=Path, default=PAGE)
    arguments = options.parse_args()
    content = json.loads(arguments.result.read_text(encoding="utf-8")) if arguments.result.exists() else None
    text = arguments.page.read_text(encoding="utf-8")
    text = replace_block(text, "cost", ABSENT if content is None else measured(content))
    text = replace_block(text, "paper", ABSENT if content is None else paper(content))
    arguments.page.write_text(text, encoding="utf-8")
    print(arguments.page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
