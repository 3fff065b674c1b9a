"""How fast training reads: shuffled balanced batches, ours against HDF5, Minari, LeRobot, datasets and zarr-python.

    python benchmarks/read.py                                          # rema-mini; without it, a synthetic release
    python benchmarks/read.py --release FOLDER --steps 4000 --samples 4096

All readers get the same rows in the same order, drawn by ``BalancedSampler``, in one process on one core, from warm
files; what they deliver is compared first, value by value. The readers take turns; a number is the median of the turns.
LeRobot needs Python 3.12 and a PyTorch of its own choice: to have all readers in one run, run the script in its
environment, with rema and Minari.
"""

from __future__ import annotations

import gc
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ.setdefault("HF_HUB_OFFLINE", "1")

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

import rema_data
from benchmarks.read_peers import CACHE, HDF5, INSTALL, MINARI, PEERS, Batch, Read, Rows, Samples
from benchmarks.results import finish, parser, target
from rema_data.errors import RemaError
from rema_data.loader.batch import FloatBatch
from rema_data.loader.release import Release
from rema_data.testing import make_release

DEFAULT_RELEASE = "rema-mini"
TASKS = ("grasp", "push", "grasp_grasp", "grasp_push")
SEED = 0
QUANTISED, FLOAT32, TAKE = "ours, quantised", "ours, float32", "numpy.take, quantised"
CHECKED_BATCHES = 3
PACKAGES = ("torch", "h5py", "zarr", "minari", "datasets", "lerobot", "pyarrow")


@contextmanager
def opened(name: str | None, episodes: int) -> Iterator[Release]:
    """The release to measure with: the named one, the default, or a synthetic one in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="rema-read-") as folder:
        try:
            release = rema_data.load(name or DEFAULT_RELEASE, cache=folder)
        except RemaError:
            if name:
                raise
            made = make_release(Path(folder) / "releases", "synthetic", TASKS, episodes=episodes)
            release = rema_data.load(made.path, cache=folder)
        yield release


def draw(release: Release, steps: int) -> Samples:
    """A random subset of the last steps of the four published tasks' training split: eight strata for a batch of 8."""
    tasks = [task for task in TASKS if any(block.key.task == task for block in release.blocks)]
    quantised = release.steps(tasks, split="train")
    rows = np.arange(len(quantised))
    if 0 < steps < len(rows):
        rows = np.sort(np.random.default_rng(SEED).choice(rows, steps, replace=False))
    table = release.to_pandas()
    table = table[table["last"] & (table["split"] == "train") & table["task"].isin(tasks)].iloc[rows]
    return Samples(release, quantised, release.steps(tasks, split="train", maps="float32"), rows, table)


def balanced_order(samples: Samples, batch_size: int, count: int) -> list[Rows]:
    """Batches of sample numbers, ``count`` in all."""
    whole = -(-count // batch_size) * batch_size
    sampler = rema_data.BalancedSampler(
        samples.quantised.select(samples.rows), batch_size, num_samples=whole, seed=SEED
    )
    return [np.asarray(batch, np.int64) for batch in sampler]


def our_readers(samples: Samples) -> dict[str, Callable[[Rows], object]]:
    """Both deliveries of the loader, and the bare gather from the same memory."""
    dataset, rows = samples.quantised, samples.rows
    maps, scene_row, ee_row = dataset.maps, dataset.rows.scene[rows], dataset.rows.ee[rows]

    def take(rows: Rows) -> object:
        ee = ee_row[rows]
        return np.take(maps.scene, scene_row[rows], 0), np.take(maps.ee_depth, ee, 0), np.take(maps.ee_mask, ee, 0)

    return {
        TAKE: take,
        QUANTISED: lambda rows: samples.quantised.__getitems__(samples.rows[rows]),
        FLOAT32: lambda rows: samples.float32.__getitems__(samples.rows[rows]),
    }


def check(name: str, read: Read, samples: Samples, order: list[Rows]) -> None:
    """Compare what a peer delivers with the loader's float32 batch.

    Raises
    ------
    AssertionError
        A value differs.
    """
    for rows in order[:CHECKED_BATCHES]:
        ours, theirs = samples.float32.__getitems__(samples.rows[rows]), read(rows)
        assert isinstance(ours, FloatBatch)
        wanted = Batch(ours.scene[:, 0], ours.end_effector, ours.action, ours.success)
        for field, mine, other in zip(Batch._fields, wanted, theirs, strict=True):
            assert torch.equal(mine, other), f"{name} delivers another {field}"


def turn(read: Callable[[Rows], object], order: list[Rows], least_s: float) -> float:
    """Seconds to read the order once; it is repeated until so much time is over."""
    passes = 0
    gc.collect()
    started = time.perf_counter()
    while True:
        for rows in order:
            batch = read(rows)
        passes += 1
        elapsed = time.perf_counter() - started
        if elapsed >= least_s:
            del batch
            return elapsed / passes


def measure(
    readers: dict[str, Callable[[Rows], object]], order: list[Rows], turns: int, least_s: float
) -> dict[str, float]:
    """Samples a second of every reader: the median of its turns, after one that warms up."""
    count = sum(map(len, order))
    seconds: dict[str, list[float]] = {name: [] for name in readers}
    for number in range(turns + 1):
        for name, read in readers.items():
            taken = turn(read, order, least_s)
            if number:
                seconds[name].append(taken)
    return {name: count / median(taken) for name, taken in seconds.items()}


def folder_bytes(folder: Path) -> int:
    """Bytes of the files of a peer, without what it caches."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.relative_to(folder).parts[0] != CACHE]
    return sum(path.stat().st_size for path in files)


def shape_of(samples: Samples) -> Table:
    """What the data are: how much of them repeats decides about sizes and about caches of processors."""
    steps, maps = samples.steps, samples.quantised.maps
    table = Table("release", "steps", "successes", "bare gripper", "different end-effector maps", "decoded, MB")
    table.title = "the data"
    table.add_row(
        samples.release.name,
        f"{len(steps):,}",
        f"{steps['success'].mean():.1%}",
        f"{(steps['embodiment'] == 'gripper').mean():.1%}",
        f"{len(np.unique(samples.quantised.rows.ee[samples.rows])):,}",
        f"{sum(array.nbytes for array in (maps.scene, maps.ee_depth, maps.ee_mask)) / 1e6:,.0f}",
    )
    return table


def judged(found: dict[int, dict[str, float]], groups: dict[str, str]) -> list[dict[str, Any]]:
    """The targets, for both batch sizes. What was not measured counts as missed."""
    rows = []
    for size, speeds in found.items():
        best: dict[str, float] = {}
        for name, group in groups.items():
            if name in speeds:
                best[group] = max(best.get(group, 0.0), speeds[name])
        for ours, factor, factor_best in ((QUANTISED, 50, 20), (FLOAT32, 10, 5)):
            wanted = [(f"{group}", best.get(group), factor) for group in (HDF5, MINARI)]
            complete = set(best) == set(groups.values())
            wanted.append(("the best of all", max(best.values()) if complete else None, factor_best))
            for what, speed, times in wanted:
                ratio = None if speed is None else speeds[ours] / speed
                measured = "not measured" if ratio is None else f"{ratio:.1f} times"
                reached = ratio is not None and ratio >= times
                rows.append(target(f"batches of {size}, {ours}: {what}", f">= {times} times", measured, reached))
        share = speeds[QUANTISED] / speeds[TAKE]
        rows.append(target(f"batches of {size}, {QUANTISED}: bare numpy.take", ">= 0.5", f"{share:.2f}", share >= 0.5))
    return rows


def versions() -> str:
    """Versions of what took part."""
    parts = []
    for package in PACKAGES:
        try:
            parts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            parts.append(f"{package} not installed")
    return ", ".join(parts)


def prepare_peers(folder: Path, samples: Samples, wanted: list[str]) -> tuple[dict[str, Read], dict[str, str]]:
    """Readers of all peers that are installed, and why there is none of the others."""
    readers: dict[str, Read] = {}
    absent: dict[str, str] = {}
    progress = Console(stderr=True)
    for peer in PEERS:
        if wanted and peer.group not in wanted:
            absent[peer.name] = "left out"
        elif missing := peer.missing():
            absent[peer.name] = f"not installed: {', '.join(missing)}"
        else:
            place = folder / peer.files
            if not place.exists():
                progress.print(f"writing {peer.files}")
                place.mkdir()
                peer.write(place, samples)
            readers[peer.name] = peer.open(place, samples)
    return readers, absent


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--release", help=f"name or folder (default: {DEFAULT_RELEASE}, else a synthetic one)")
    options.add_argument("--episodes", type=int, default=1000, help="of each task of the synthetic one (default 1000)")
    options.add_argument("--steps", type=int, default=4000, help="steps that are stored and drawn from (default 4000)")
    options.add_argument("--samples", type=int, default=4096, help="samples of a turn (default 4096)")
    options.add_argument("--batches", default="8,256", help="batch sizes")
    options.add_argument("--repeats", type=int, default=3, help="turns (default 3)")
    options.add_argument("--seconds", type=float, default=0.5, help="quick readers repeat a turn so long (default 0.5)")
    options.add_argument("--peers", default="", help="only these groups, comma-separated, such as HDF5,Minari")
    options.add_argument("--folder", type=Path, help="where the peers' files go for the time (a temporary folder)")
    arguments = options.parse_args()
    torch.set_num_threads(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    found: dict[int, dict[str, float]] = {}
    with (
        opened(arguments.release, arguments.episodes) as release,
        tempfile.TemporaryDirectory(prefix="rema-peers-", dir=arguments.folder) as folder,
    ):
        samples = draw(release, arguments.steps)
        peers, absent = prepare_peers(Path(folder), samples, [name for name in arguments.peers.split(",") if name])
        stored = {
            peer.name: folder_bytes(Path(folder) / peer.files) for peer in PEERS if peer.name in peers and peer.files
        }
        for size in (int(text) for text in arguments.batches.split(",")):
            order = balanced_order(samples, size, arguments.samples)
            for name, read in peers.items():
                check(name, read, samples, order)
            found[size] = measure(our_readers(samples) | peers, order, arguments.repeats, arguments.seconds)
        data = shape_of(samples)
        distinct = len(np.unique(np.concatenate(order)))
    return report(arguments, found, absent, stored, data, len(samples.rows), distinct)


def report(
    arguments: Any,
    found: dict[int, dict[str, float]],
    absent: dict[str, str],
    stored: dict[str, int],
    data: Table,
    steps: int,
    distinct: int,
) -> int:
    """Print and write what was measured."""
    columns = [f"batches of {size}" for size in found]
    table = Table("reader", *columns, "times quantised", "times float32", "bytes a step on disk")
    table.title = "samples a second, one core"
    for name in next(iter(found.values())):
        speeds = [f"{speeds[name]:,.0f}" for speeds in found.values()]
        ratios = [
            " / ".join(f"{speeds[ours] / speeds[name]:.1f}" for speeds in found.values())
            for ours in (QUANTISED, FLOAT32)
        ]
        disk = f"{stored[name] / steps:,.0f}" if name in stored else ""
        table.add_row(name, *speeds, *ratios, disk)
    for name, why in absent.items():
        table.add_row(name, *["-"] * len(found), "-", "-", why)
    notes = [
        f"Versions: {versions()}.",
        f"{steps:,} steps; each repeat reads {arguments.samples:,} samples, {distinct:,} of them different.",
        "`quantised` delivers what is sent to a device: int16 heights and packed masks, 61.5 KB a sample. All others "
        "deliver float32 tensors on the CPU, 217 KB a sample. The values were compared: all readers deliver the same.",
        "In the files of the other readers every step is a separate episode; of LeRobot, which reads single frames, "
        "200 are one. Minari's files have an empty observation after a step, as the format requires.",
    ]
    if any(why.startswith("not installed") for why in absent.values()):
        notes.append(f"To measure all: {INSTALL}")
    groups = {peer.name: peer.group for peer in PEERS}
    numbers = {"samples_per_second": {str(size): speeds for size, speeds in found.items()}, "absent": absent}
    numbers |= {"steps": steps, "distinct": distinct, "bytes_on_disk": stored}
    return finish(arguments, "read", [data, table], judged(found, groups), notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
