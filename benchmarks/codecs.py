"""How the maps compress: size and decoding speed of codecs, levels, shuffles and chunk sizes, on maps of the world.

    python benchmarks/codecs.py                                        # 500 episodes a task, observed for this purpose
    python benchmarks/codecs.py --release rema-mini                    # the blocks of a release
    python benchmarks/codecs.py --arrays ee_depth --chunks 16,64 --levels 9

Every setting writes the arrays that a release would hold, block by block (one block a task), in memory, with
zarr-python, and reads them back whole, on one core. Bytes include the shard indices. Blosc's level 9 is zstd's highest.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import numpy.typing as npt
import zarr
from rich.table import Table
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec, ZstdCodec
from zarr.storage import MemoryStore

from benchmarks.results import finish, parser
from benchmarks.situations import ROOT_SEED
from evaluator.sim.observation import observe
from evaluator.sim.reference import prepare
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import episode_generator
from rema_data.release.folder import find_release
from rema_data.schema import TASKS, Observation, Situation
from rema_data.store.block import encode_maps
from rema_data.store.maps import ARRAYS

Blocks = list[npt.NDArray[Any]]
SHUFFLES = ("none", "noshuffle", "shuffle", "bitshuffle")
"""``none`` is plain zstd; the others are blosc with zstd inside."""
START = 5_000_000
"""First episode of the seed domain: none that another benchmark uses."""
MB = 1e6
BLOSC_LEVELS = 9
"""Higher levels are for plain zstd only."""


def observed(task: str, episodes: int, simulator: Simulator) -> list[Observation]:
    """Observations of all steps of some episodes whose tools were picked up by the reference pick."""
    seen = []
    for episode in range(START, START + episodes):
        ready = prepare(simulator, task, episode_generator(ROOT_SEED, "calibrate", task, episode))
        for step, (kind, placement) in enumerate(zip(TASKS[task], ready.placements, strict=True)):
            grips = ready.grips[:step]
            pinch = ready.pinch if kind is TASKS[task][-1] else None
            seen.append(observe(Situation(task, step, placement, grips, pinch)))
    return seen


def observed_blocks(tasks: list[str], episodes: int) -> dict[str, Blocks]:
    """Stored arrays of one block a task."""
    simulator = Simulator()
    encoded = [encode_maps(observed(task, episodes, simulator)) for task in tasks]
    simulator.close()
    return {name: [getattr(maps, name) for maps in encoded] for name in ARRAYS}


def release_blocks(name: str) -> dict[str, Blocks]:
    """Stored arrays of the blocks of a release that are on this machine."""
    release = find_release(name)
    readers = [release.block(block).maps() for block in release.blocks()]
    return {name: [reader.read(name, 0, reader.rows(name)) for reader in readers] for name in ARRAYS}


def written(name: str, rows: npt.NDArray[Any], shuffle: str, level: int, chunk_rows: int) -> MemoryStore:
    """One array as ``rema_data.store.maps`` writes it, with other settings."""
    form = ARRAYS[name]
    item = np.dtype(form.dtype).itemsize
    codec = (
        ZstdCodec(level=level)
        if shuffle == "none"
        else BloscCodec(cname="zstd", clevel=level, shuffle=shuffle, typesize=item)  # type: ignore[arg-type]
    )
    store = MemoryStore()
    array = zarr.create_array(
        store,
        shape=rows.shape,
        dtype=form.dtype,
        chunks=(chunk_rows, *form.row),
        shards=(max(form.shard_rows, chunk_rows), *form.row),
        serializer=BytesCodec(),
        compressors=[codec, Crc32cCodec()],
        fill_value=form.fill,
        config={"write_empty_chunks": True},
    )
    array[:] = rows
    return store


def stored_bytes(store: MemoryStore) -> int:
    """Bytes of all files of an array."""
    return sum(len(value) for value in store._store_dict.values())


def measure(name: str, blocks: Blocks, shuffle: str, level: int, chunk_rows: int, repeats: int) -> dict[str, Any]:
    """Bytes a row, and how fast all blocks are decoded."""
    rows = sum(len(block) for block in blocks)
    raw = sum(block.nbytes for block in blocks)
    started = time.perf_counter()
    stores = [written(name, block, shuffle, level, chunk_rows) for block in blocks]
    encoding = time.perf_counter() - started
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        for store, block in zip(stores, blocks, strict=True):
            back = np.asarray(zarr.open_array(store, mode="r")[:])
            assert back.shape == block.shape
        times.append(time.perf_counter() - started)
    assert np.array_equal(back, blocks[-1])
    return {
        "array": name,
        "codec": "zstd" if shuffle == "none" else f"blosc-zstd {shuffle}",
        "level": level,
        "chunk_rows": chunk_rows,
        "rows": rows,
        "bytes_per_row": sum(map(stored_bytes, stores)) / rows,
        "decode_mb_per_s": raw / MB / median(times),
        "encode_mb_per_s": raw / MB / encoding,
    }


def main() -> int:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--release", help="name or folder of a release, instead of observing episodes")
    options.add_argument("--tasks", default=",".join(TASKS))
    options.add_argument("--episodes", type=int, default=500, help="of each task (default 500)")
    options.add_argument("--arrays", default=",".join(ARRAYS))
    options.add_argument("--shuffles", default=",".join(SHUFFLES))
    options.add_argument("--levels", default="3,5,9,19")
    options.add_argument("--chunks", default="16,32,64,128,256,512", help="rows of a chunk")
    options.add_argument("--repeats", type=int, default=3)
    arguments = options.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    if arguments.release:
        arrays, source = release_blocks(arguments.release), f"the blocks of {arguments.release}"
    else:
        arrays = observed_blocks(arguments.tasks.split(","), arguments.episodes)
        source = f"{arguments.episodes} episodes of each of {arguments.tasks}"
    levels = [int(level) for level in arguments.levels.split(",")]
    chunks = [int(chunk) for chunk in arguments.chunks.split(",")]
    found: list[dict[str, Any]] = []
    tables = []
    for name in arguments.arrays.split(","):
        blocks = [block for block in arrays[name] if len(block)]
        settings = itertools.product(arguments.shuffles.split(","), levels, chunks)
        measured = [
            measure(name, blocks, shuffle, level, chunk_rows, arguments.repeats)
            for shuffle, level, chunk_rows in settings
            if level <= BLOSC_LEVELS or shuffle == "none"
        ]
        found += measured
        raw = blocks[0][0].nbytes
        title = f"{name}: {measured[0]['rows']:,} rows of {raw:,} bytes; bytes a row (decoded MB/s)"
        table = Table("codec", "level", *[f"chunks of {chunk}" for chunk in chunks], "writing, MB/s", title=title)
        for (codec, level), group in itertools.groupby(measured, lambda row: (row["codec"], row["level"])):
            rows = list(group)
            cells = [f"{row['bytes_per_row']:.1f} ({row['decode_mb_per_s']:,.0f})" for row in rows]
            table.add_row(codec, str(level), *cells, f"{min(row['encode_mb_per_s'] for row in rows):,.0f}")
        tables.append(table)
    notes = [f"Maps: {source}; equal end-effector maps of a block once."]
    return finish(arguments, "codecs", tables, [], notes, {"settings": found})


if __name__ == "__main__":
    sys.exit(main())
