"""How small a release is: bytes a step against gzip HDF5 in robomimic's layout, compressed npz, and raw float32.

    python benchmarks/size.py                                          # rema-mini; without it, a synthetic release
    python benchmarks/size.py --release FOLDER

Two comparisons. What training reads: the maps with action and success; the others hold the maps as float32 in metres.
And everything: the same with all columns of the tables. Every file is written, and its size is read from the disk.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.read import DEFAULT_RELEASE, opened
from benchmarks.read_peers import Demo, write_demos
from benchmarks.results import finish, parser, target
from rema_data.loader.batch import FloatBatch
from rema_data.loader.release import Release
from rema_data.release.manifest import MANIFEST
from rema_data.schema import TASKS
from rema_data.store.block import STEPS

GZIP_LEVELS = (4, 9)
OTHERS = (*(f"HDF5 gzip {level}" for level in GZIP_LEVELS), "npz")
PIECE = 512
RAW_BYTES = (64 * 64 + 4 * 112 * 112) * 4
"""Of one step's maps as float32."""
LABELS = ("action", "success", "scene_row", "ee_row")
"""Columns of the steps without which the maps are of no use."""
DEFLATE_LIMIT = 1032
"""At best 258 bytes in two bits."""
WANTED = 5.0


def pieces(release: Release, task: str) -> Iterator[FloatBatch]:
    """All steps of a task as float32, in order."""
    dataset = release.steps(tasks=[task], which="all", maps="float32")
    for start in range(0, len(dataset), PIECE):
        piece = dataset[start : start + PIECE]
        assert isinstance(piece, FloatBatch)
        yield piece


def demos(release: Release, task: str) -> Iterator[Demo]:
    """All episodes of a task."""
    dataset = release.steps(tasks=[task], which="all", maps="float32")
    lengths = dataset.table.groupby(["round", "split", "episode"], sort=False, observed=True).size()
    start = 0
    for steps in lengths.tolist():
        batch = dataset[start : start + steps]
        assert isinstance(batch, FloatBatch)
        yield batch.scene[:, 0].numpy(), batch.end_effector.numpy(), batch.action.tolist(), batch.success.tolist()
        start += steps


def npz_bytes(folder: Path, release: Release, task: str) -> int:
    """Size of the task's steps in compressed npz files, hundreds of steps in each."""
    total = 0
    file = folder / "piece.npz"
    for piece in pieces(release, task):
        arrays = {name: getattr(piece, name).numpy() for name in ("scene", "end_effector", "action", "success")}
        np.savez_compressed(file, **arrays)
        total += file.stat().st_size
    file.unlink()
    return total


def hdf5_bytes(folder: Path, release: Release, task: str, level: int) -> int:
    """Size of the task's file in robomimic's layout."""
    file = folder / "task.hdf5"
    write_demos(file, demos(release, task), level)
    size = file.stat().st_size
    file.unlink()
    return size


def table_bytes(folder: Path, release: Release, task: str) -> int:
    """Size of the task's tables as arrays in a compressed npz file."""
    file = folder / "tables.npz"
    arrays = {}
    for name, frame in (("episodes", release.episodes), ("steps", release.to_pandas())):
        for column, values in frame[frame["task"] == task].items():
            plain = values.to_numpy()
            arrays[f"{name}/{column}"] = plain.astype(np.str_) if plain.dtype.kind not in "biuf" else plain
    np.savez_compressed(file, **arrays)
    size = file.stat().st_size
    file.unlink()
    return size


def our_bytes(release: Release, task: str) -> dict[str, int]:
    """Bytes of the task's files: maps, the columns that training reads, and the rest of the tables."""
    blocks = {block.key.path for block in release.blocks if block.key.task == task}
    found = dict.fromkeys(("maps", "labels", "tables"), 0)
    for entry in release.manifest.files:
        if entry.block not in blocks:
            continue
        file = release.folder.file(entry)
        size = file.stat().st_size
        if file.suffix != ".parquet":
            found["maps"] += size
            continue
        labels = column_bytes(file, LABELS) if file.name == STEPS else 0
        found["labels"] += labels
        found["tables"] += size - labels
    return found


def column_bytes(file: Path, names: tuple[str, ...]) -> int:
    """Compressed bytes of some columns of a Parquet file."""
    metadata = pq.ParquetFile(file).metadata
    groups = (metadata.row_group(number) for number in range(metadata.num_row_groups))
    columns = (group.column(number) for group in groups for number in range(group.num_columns))
    return sum(column.total_compressed_size for column in columns if column.path_in_schema in names)


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--release", help=f"name or folder (default: {DEFAULT_RELEASE}, else a synthetic one)")
    options.add_argument("--episodes", type=int, default=1000, help="of each task of the synthetic one (default 1000)")
    arguments = options.parse_args()
    rows: dict[str, dict[str, int]] = {}
    with (
        opened(arguments.release, arguments.episodes) as release,
        tempfile.TemporaryDirectory(prefix="rema-size-") as name,
    ):
        for task in TASKS:
            if any(block.key.task == task for block in release.blocks):
                rows[task] = measure(Path(name), release, task)
        files = [release.folder.file(entry) for entry in release.manifest.files if not entry.block]
        described = sum(file.stat().st_size for file in files)
        described += (release.folder.path / MANIFEST).stat().st_size
        released = release.name
    total = {key: sum(sizes[key] for sizes in rows.values()) for key in next(iter(rows.values()))}
    return report(arguments, released, rows | {"all": total}, described)


def measure(folder: Path, release: Release, task: str) -> dict[str, int]:
    """Bytes of everything that is compared, and the number of steps."""
    sizes = {"steps": sum(block.steps for block in release.blocks if block.key.task == task)}
    sizes |= our_bytes(release, task)
    sizes |= {f"HDF5 gzip {level}": hdf5_bytes(folder, release, task, level) for level in GZIP_LEVELS}
    sizes |= {"npz": npz_bytes(folder, release, task), "tables as npz": table_bytes(folder, release, task)}
    return sizes


def report(arguments: argparse.Namespace, released: str, rows: dict[str, dict[str, int]], described: int) -> int:
    """Print and write what was measured; the last row holds the sums."""
    reading = Table("task", "steps", "release", *OTHERS, "raw float32", "times the best")
    reading.title = f"{released}, maps with action and success: bytes a step"
    whole = Table("task", "maps", "labels", "other columns", "release", "npz with all columns", "times")
    whole.title = f"{released}, everything: bytes a step"
    ratios: dict[str, tuple[float, str, float]] = {}
    for task, sizes in rows.items():
        steps, read = sizes["steps"], sizes["maps"] + sizes["labels"]
        best = min(OTHERS, key=lambda other: sizes[other])
        ours, theirs = read + sizes["tables"], sizes["npz"] + sizes["tables as npz"]
        ratios[task] = sizes[best] / read, best, theirs / ours
        cells = [f"{size / steps:,.0f}" for size in (read, *(sizes[other] for other in OTHERS))]
        reading.add_row(task, f"{steps:,}", *cells, f"{RAW_BYTES:,}", f"{ratios[task][0]:.1f}")
        parts = (sizes["maps"], sizes["labels"], sizes["tables"], ours, theirs)
        whole.add_row(task, *(f"{size / steps:,.0f}" for size in parts), f"{ratios[task][2]:.1f}")
    (ratio, best, ratio_all), total = ratios["all"], rows["all"]
    verdicts = [
        target(f"maps with action and success: {best}", f">= {WANTED:g} times", f"{ratio:.1f}", ratio >= WANTED),
        target("everything: npz with all columns", f">= {WANTED:g} times", f"{ratio_all:.1f}", ratio_all >= WANTED),
    ]
    ours = total["maps"] + total["labels"] + total["tables"]
    notes = [
        f"Tables included, the release is {RAW_BYTES * total['steps'] / ours:,.0f} times smaller than raw float32. "
        f"Deflate compresses at most {DEFLATE_LIMIT:,} times, so gzip HDF5 and npz take "
        f"{RAW_BYTES / DEFLATE_LIMIT:.0f} bytes a step or more, even for empty maps.",
        "The columns that are not labels hold poses, sizes and measurements: numbers that hardly compress.",
        f"Manifest, datasheet, Croissant file and licence: {described:,} bytes in all, not counted above.",
    ]
    numbers = {"tasks": rows, "description": described, "raw_bytes_a_step": RAW_BYTES}
    return finish(arguments, "size", [reading, whole], verdicts, notes, numbers)


if __name__ == "__main__":
    sys.exit(main())
