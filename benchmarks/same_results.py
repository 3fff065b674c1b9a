"""Did a change of the code change a result? Records what the code gives, and compares a later state of it with that.

    python benchmarks/same_results.py record before.json     # some minutes
    python benchmarks/same_results.py check before.json      # exits with 6 where something differs

Recorded are the hashes of the constants, protocols and lists; the maps of the first test scenarios; whole runs of
``random`` and ``scripted``; the decisions of ``tae-joint``; and the first episodes of each round of ``tiny.toml``.
Everything goes through the command line and the public readers, so that the same script measures both states. The rows
of a table are compared by value, in the columns that both states have: a column that was added is named, and is no
difference. Digests of a policy's code are left out, since that code is what changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import pyarrow.parquet as pq
import rich

import rema_data
from evaluator.protocol import PROTOCOLS, protocol_hash
from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.parameters import parameters_hash
from rema_data.schema import TASKS, Observation

DIFFERENT = 6
CODE_COLUMNS = {"policy_digest"}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("what", choices=["record", "check"])
    arguments.add_argument("file", type=Path)
    arguments.add_argument("--episodes", type=int, default=300, help="of every run of random and scripted")
    arguments.add_argument("--decisions", type=int, default=500, help="of tae-joint in every task")
    arguments.add_argument("--observations", type=int, default=400, help="in every task")
    arguments.add_argument("--collected", type=int, default=50, help="episodes of every round of tiny.toml")
    options = arguments.parse_args()
    found = measure(options)
    if options.what == "record":
        options.file.write_text(json.dumps(found, indent=1) + "\n")
        return
    recorded = json.loads(options.file.read_text())
    problems = list(compare(recorded, found))
    for problem in problems:
        rich.print(problem)
    rich.print(f"{len(recorded)} records compared, {len(problems)} differ")
    sys.exit(DIFFERENT if problems else 0)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Everything that is recorded, by name: a hash, or the hashes of a table's columns."""
    found: dict[str, Any] = {"parameters": parameters_hash()}
    for task in TASKS:
        for split in ("test", "val"):
            found[f"list {task}/{split}"] = load_list(task, split).sha256
        for protocol in PROTOCOLS:
            found[f"protocol {task} {protocol}"] = protocol_hash(task, protocol)
        seen = [observe(one.last_situation()) for one in load_list(task).scenarios[: options.observations]]
        found[f"observations {task}"] = digest(maps for one in seen for maps in _maps(one))
    with tempfile.TemporaryDirectory() as folder:
        box = Path(folder)
        for task in TASKS:
            for policy, episodes in (("random", options.episodes), ("scripted", options.episodes)):
                table = evaluated(box / f"{policy}-{task}", policy, task, episodes)
                found[f"run {policy} {task}"] = columns_of(table)
            table = evaluated(box / f"tae-joint-{task}", "tae-joint", task, options.decisions)
            actions = [name for name in table.column_names if name.endswith("_action")]
            found[f"decisions tae-joint {task}"] = columns_of(table.select(["index", *actions]))
        rema("rounds", "examples/tiny.toml", "--output", str(box / "tiny"))
        for manifest in sorted((box / "tiny").glob("*/manifest.json")):
            found |= collected(manifest.parent, options.collected)
    return found


def rema(*arguments: str) -> None:
    """One command of the product, in a process of its own."""
    command = [sys.executable, "-m", "evaluator.cli", *arguments]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    subprocess.run(command, cwd=ROOT, check=True, env=environment, stdout=subprocess.DEVNULL)


def evaluated(output: Path, policy: str, task: str, episodes: int) -> Any:
    """Rows of a new run."""
    rema("evaluate", policy, "--task", task, "--episodes", str(episodes), "--output", str(output))
    (path,) = [file for name in ("results", "episodes") if (file := output / f"{name}.parquet").exists()]
    return pq.read_table(path)


def columns_of(table: Any) -> dict[str, str]:
    """Hash of every column's values."""
    return {
        name: digest([json.dumps(table[name].to_pylist()).encode()])
        for name in table.column_names
        if name not in CODE_COLUMNS
    }


def collected(folder: Path, episodes: int) -> dict[str, Any]:
    """The first episodes of every round of a release: their tables, and the maps of their steps."""
    release = rema_data.load(folder, cache="memory")
    found: dict[str, Any] = {}
    for number in sorted({block.key.round for block in release.blocks}):
        frame = release.episodes[release.episodes["round"] == number].head(episodes)
        keys = [tuple(row) for row in frame[["round", "task", "split", "episode"]].itertuples(index=False)]
        every = release.to_pandas()
        steps = every[[tuple(row) in set(keys) for row in every[["round", "task", "split", "episode"]].to_numpy()]]
        for name, table in (("episodes", frame), ("steps", steps)):
            found[f"{folder.name} round {number} {name}"] = {
                column: digest([table[column].to_json(orient="values", double_precision=15).encode()])
                for column in table.columns
                if column not in CODE_COLUMNS
            }
        maps = (
            part
            for key in keys
            for step in release.episode(int(key[0]), key[1], key[2], int(key[3])).steps
            for part in _maps(step.observation)
        )
        found[f"{folder.name} round {number} maps"] = digest(maps)
    return found


def _maps(observation: Observation) -> tuple[bytes, bytes, bytes]:
    return observation.scene.tobytes(), observation.depth.tobytes(), observation.mask.tobytes()


def digest(parts: Iterable[bytes]) -> str:
    """sha256, hexadecimal."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return total.hexdigest()


def compare(recorded: dict[str, Any], found: dict[str, Any]) -> Iterable[str]:
    """One sentence a difference."""
    for name, before in recorded.items():
        now = found.get(name)
        if not isinstance(before, dict) or not isinstance(now, dict):
            if before != now:
                yield f"{name}: {before} before, {now} now"
            continue
        for column in before:
            if column in now and now[column] != before[column]:
                yield f"{name}: column {column} has other values"
            elif column not in now:
                yield f"{name}: column {column} is gone"


if __name__ == "__main__":
    main()
