"""How long a release takes to open: the first time, when it is decoded, and every time after; and rema to start.

    python benchmarks/open.py                          # 100,000 synthetic steps
    python benchmarks/open.py --release rema-mini      # a release that is on this machine

The synthetic release has five rounds of a task with bare grippers and of one with tools. Every opening is a process of
its own; the files are in the page cache.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import pyarrow as pa
from rich.table import Table

from benchmarks.results import ROOT, finish, parser, target
from rema_data.release.folder import ReleaseFolder, find_release
from rema_data.release.seal import Description, seal
from rema_data.store.block import EPISODES, STEPS, BlockKey, BlockReader
from rema_data.store.tables import to_parquet
from rema_data.testing import FINGERPRINT, make_block

ROUNDS = 5
TASKS = {"grasp": 1.0, "grasp_push": 1.9}
"""Tasks of the synthetic release, with the steps of an episode."""
OPEN_S = 0.3
HELP_S = 0.15
IMPORT_S = 0.3
STARTS = {"`rema --help`": ("-m", "evaluator.cli", "--help"), "`import rema_data`": ("-c", "import rema_data")}
"""What is timed as a process of its own, with the start of the interpreter."""

OPEN = """
import json, sys, time
began = time.perf_counter()
import torch, torch.utils.data
torch_s = time.perf_counter()
import rema_data
rema_data.load, rema_data.StepDataset
imported = time.perf_counter()
release = rema_data.load(sys.argv[1])
loaded = time.perf_counter()
dataset = release.steps(split="train", which="all")
batch = dataset.__getitems__(list(range(0, len(dataset), len(dataset) // 8))[:8])
assert len(batch) == 8
first = time.perf_counter()
dataset.table
table = time.perf_counter()
sampler = rema_data.BalancedSampler(dataset, batch_size=8, by=("task", "success"), seed=0)
next(iter(torch.utils.data.DataLoader(dataset, batch_sampler=sampler)))
balanced = time.perf_counter()
marks = {"import torch": torch_s - began, "import rema_data": imported - torch_s, "load()": loaded - imported,
         "steps() and the first batch": first - loaded, "table (imports pandas)": table - first,
         "balanced sampler and its first batch": balanced - table}
print(json.dumps(marks))
"""

NUMPY = """
import json, sys, time
began = time.perf_counter()
import rema_data
dataset = rema_data.load(sys.argv[1]).steps(split="train", which="all")
batch = dataset.arrays[:: len(dataset) // 8]
assert len(batch.action) >= 8 and "torch" not in sys.modules
print(json.dumps({"seconds": time.perf_counter() - began}))
"""

DECODE = """
import json, os, sys, time
from collections import defaultdict
if sys.argv[2] == "1":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import filelock, pyarrow.compute
import rema_data
from rema_data.loader import build, decode
from rema_data.store.maps import MapsReader
spent = defaultdict(float)
def timed(owner, name, what):
    plain = getattr(owner, name)
    def call(*words, **options):
        began = time.perf_counter()
        try:
            return plain(*words, **options)
        finally:
            spent[what] += time.perf_counter() - began
    setattr(owner, name, call)
timed(decode, "_check", "sha256 of the files")
timed(MapsReader, "read", "reading and decompressing")
timed(decode, "decode_heights", "fixed point to 0.1 mm")
timed(build._FileSink, "put", "writing")
timed(build, "sync_file", "fsync")
release = rema_data.load(sys.argv[1])
began = time.perf_counter()
opened = release.cache
total = time.perf_counter() - began
size = sum(file.stat().st_size for file in opened.folder.iterdir())
print(json.dumps({"total": total, "bytes": size, "parts": spent}))
"""


def synthetic(root: Path, steps: int) -> ReleaseFolder:
    """A release of at least so many steps. Its rounds hold equal maps: what is measured does not depend on that."""
    staging, keys = root / ".staging", []
    for task, per_episode in TASKS.items():
        first = BlockKey(1, task, "train")
        make_block(staging / first.path, first, math.ceil(steps / len(TASKS) / ROUNDS / per_episode * 1.03))
        reader = BlockReader(staging / first.path)
        tables = {EPISODES: reader.episodes(), STEPS: reader.steps()}
        for number in range(1, ROUNDS + 1):
            key = BlockKey(number, task, "train")
            keys.append(key)
            if number > 1:
                shutil.copytree(staging / first.path, staging / key.path)
                for name, table in tables.items():
                    at = table.schema.get_field_index("round")
                    field = table.schema.field(at)
                    column = pa.array([number] * len(table), field.type)
                    (staging / key.path / name).write_bytes(to_parquet(table.set_column(at, field, column)))
    about = Description("synthetic", "Synthetic", "For the benchmark of opening.", "CC-BY-4.0", "The rema authors")
    return seal(staging, root, about, keys, fingerprint=FINGERPRINT)


def child(script: str, home: Path, *words: str) -> dict[str, Any]:
    """What a script prints, run in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "REMA_HOME": str(home)}
    done = subprocess.run(
        [sys.executable, "-c", script, *words], cwd=ROOT, env=environment, stdout=subprocess.PIPE, check=True
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def start(*words: str) -> float:
    """Seconds that a Python process takes from its start to its end."""
    began = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - began


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--release", help="name or folder of a release, instead of a synthetic one")
    options.add_argument("--steps", type=int, default=100_000)
    options.add_argument("--repeats", type=int, default=5)
    arguments = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="rema-open-") as folder:
        home = Path(folder) / "home"
        if arguments.release:
            release = find_release(arguments.release)
        else:
            release = synthetic(Path(folder) / "releases", arguments.steps)
        path, counts = str(release.path), release.manifest.counts
        decoded = {}
        for cores in ("1", "all"):
            shutil.rmtree(home, ignore_errors=True)
            decoded[cores] = child(DECODE, home, path, cores)
        openings = [child(OPEN, home, path) for _ in range(arguments.repeats + 1)][1:]
        arrays = [child(NUMPY, home, path)["seconds"] for _ in range(arguments.repeats + 1)][1:]
    starts = {
        what: statistics.median([start(*words) for _ in range(arguments.repeats + 1)][1:])
        for what, words in STARTS.items()
    }
    starts["load() and the first batch as arrays, without torch"] = statistics.median(arrays)
    marks = {what: statistics.median(opening[what] for opening in openings) for what in openings[0]}
    after_torch = marks["import rema_data"] + marks["load()"] + marks["steps() and the first batch"]
    calls = marks["load()"] + marks["steps() and the first batch"]

    stored = counts["bytes"]
    first = Table("", "one core", "all cores", title=f"first opening: {counts['steps']:,} steps are decoded once")
    one, every = decoded["1"], decoded["all"]
    first.add_row("stored, MB", *[f"{stored / 1e6:.1f}"] * 2)
    first.add_row("decoded, MB", *(f"{row['bytes'] / 1e6:.0f}" for row in (one, every)))
    first.add_row("seconds", *(f"{row['total']:.2f}" for row in (one, every)))
    first.add_row("decoded MB/s", *(f"{row['bytes'] / row['total'] / 1e6:.0f}" for row in (one, every)))
    for part, seconds in one["parts"].items():
        first.add_row(f"share of the time: {part}", f"{seconds / one['total']:.0%}", "")
    second = Table("", "ms", title="second opening, median of new processes")
    for what, seconds in marks.items():
        second.add_row(what, f"{seconds * 1e3:.1f}")
    third = Table("", "ms", title="starts, median of new processes")
    for what, seconds in starts.items():
        third.add_row(what, f"{seconds * 1e3:.1f}")
    limits = dict(zip(STARTS, (HELP_S, IMPORT_S), strict=True))
    targets = [
        *(target(what, f"< {most} s", f"{starts[what]:.3f} s", starts[what] < most) for what, most in limits.items()),
        target(
            "second load() and first batch, after `import torch`",
            f"< {OPEN_S} s",
            f"{after_torch:.3f} s",
            after_torch < OPEN_S,
        ),
    ]
    notes = [
        f"Of the {after_torch:.3f} s the two calls take {calls:.3f} s; the rest imports modules. Importing torch "
        f"itself takes {marks['import torch']:.2f} s, as in every program that uses torch.",
        "On one core the stages run one after the other; the rest of the 100 % is tables, manifest and renaming.",
        f"{counts['end_effectors']:,} of {counts['steps']:,} steps have their own end-effector map.",
    ]
    numbers = {"counts": counts, "decode": decoded, "open": marks, "after_torch_s": after_torch, "calls_s": calls}
    numbers["starts_s"] = starts
    return finish(arguments, "open", [first, second, third], targets, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
