"""Speed of the balanced sampler: indices a second, construction, and going on in the middle, beside torch's sampler.

    python benchmarks/sampler.py --json benchmarks/results/sampler.json
    python benchmarks/sampler.py --rows 175000 --large-rows 1000000 --indices 100000     # quicker

torch's ``WeightedRandomSampler`` draws with replacement by weights of the same labels, and ``BatchSampler`` makes
batches of them. Both are timed from ``iter`` on, in turns; the best of the repeats counts. Run it alone.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import pandas as pd
import torch
from rich.table import Table
from torch.utils.data import BatchSampler, WeightedRandomSampler

from benchmarks.results import finish, parser, target
from rema_data.samplers import BalancedSampler

TASKS = ("grasp", "push", "grasp_grasp", "grasp_push")
POSITIVES = (0.3, 0.5, 0.014, 0.2)
BATCHES = (8, 256)
WANTED_PER_S = 1e6
WANTED_CONSTRUCTION_S = 5.0
VARIANTS: dict[str, dict[str, Any]] = {
    "exact, cycle (the default)": {},
    "average, cycle": {"mode": "average"},
}
TORCH = "torch WeightedRandomSampler"


def columns_of(rows: int) -> dict[str, np.ndarray]:
    """Task and success of so many rows, tasks as codes."""
    rng = np.random.default_rng(0)
    task = rng.integers(len(TASKS), size=rows, dtype=np.int8)
    return {"task": task, "success": rng.random(rows, dtype=np.float32) < np.array(POSITIVES, np.float32)[task]}


def seconds(action: Callable[[], object]) -> float:
    """Wall time of a call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def drain(batches: Iterable[Any]) -> None:
    """Take every batch, and do nothing with it."""
    for _ in batches:
        pass


def torch_batches(columns: dict[str, np.ndarray], batch: int, draws: int) -> Iterator[list[int]]:
    """The same balance by torch's own means."""
    code = columns["task"].astype(np.int64) * 2 + columns["success"]
    weights = torch.from_numpy((1 / np.bincount(code))[code])
    generator = torch.Generator().manual_seed(0)
    sampler = WeightedRandomSampler(weights, draws, replacement=True, generator=generator)  # type: ignore[arg-type]
    return iter(BatchSampler(sampler, batch, drop_last=True))


def rates(rows: int, indices: int, repeats: int) -> dict[str, dict[str, float]]:
    """Indices a second by sampler and batch size."""
    columns = columns_of(rows)
    found: dict[str, dict[str, float]] = {name: {} for name in (*VARIANTS, TORCH)}
    for batch in BATCHES:
        draws = indices // batch * batch
        best = dict.fromkeys(found, float("inf"))
        for _ in range(repeats):
            for name, options in VARIANTS.items():
                sampler = BalancedSampler(columns, batch, num_samples=draws, **options)
                best[name] = min(best[name], seconds(lambda sampler=sampler: drain(sampler)))
            batches = torch_batches(columns, batch, draws)
            best[TORCH] = min(best[TORCH], seconds(lambda batches=batches: drain(batches)))
        for name, took in best.items():
            found[name][str(batch)] = draws / took
    return found


def construction(rows: int, repeats: int) -> dict[str, float]:
    """Seconds to make a sampler of a large table, by the type of its task column."""
    columns = columns_of(rows)
    names = pd.Categorical.from_codes(columns["task"], categories=list(TASKS))
    tables = {
        "codes (int8)": columns,
        "categories": pd.DataFrame({"task": names, "success": columns["success"]}),
        "text": pd.DataFrame({"task": names.astype("str"), "success": columns["success"]}),
    }
    return {
        kind: min(seconds(lambda table=table: BalancedSampler(table, 256)) for _ in range(repeats))
        for kind, table in tables.items()
    }


def torch_limit(rows: int) -> str:
    """What torch's sampler says to so many rows."""
    try:
        next(iter(WeightedRandomSampler(torch.ones(rows), 1)))
    except RuntimeError as error:
        return str(error).splitlines()[0]
    return "draws"


def positions(rows: int, repeats: int) -> dict[str, float]:
    """Seconds to the first batch of a large table: at the start, and resumed a thousand epochs later."""
    sampler = BalancedSampler(columns_of(rows), 256)
    drain(islice(sampler, 3))
    start = sampler.state_dict() | {"epoch": 0, "batch": 0}
    later = start | {"epoch": 1000, "batch": len(sampler) // 2}
    found = {}
    for name, state in (("first batch", start), ("first batch, resumed in epoch 1000", later)):
        best = float("inf")
        for _ in range(repeats):
            again = BalancedSampler(columns_of(rows), 256)
            again.load_state_dict(state)
            best = min(best, seconds(lambda again=again: next(iter(again))))
        found[name] = best
    return found


def main() -> int:
    """Measure, print, write."""
    made = parser(__doc__)
    made.add_argument("--rows", type=int, default=175_000, help="of the table that is drawn from")
    made.add_argument("--large-rows", type=int, default=20_000_000, help="of the table for construction")
    made.add_argument("--indices", type=int, default=4_000_000)
    made.add_argument("--repeats", type=int, default=3)
    arguments = made.parse_args()

    found = rates(arguments.rows, arguments.indices, arguments.repeats)
    speed = Table(
        "sampler", *(f"batch {batch}" for batch in BATCHES), title=f"indices a second, {arguments.rows:,} rows"
    )
    for name, by_batch in found.items():
        speed.add_row(name, *(f"{by_batch[str(batch)] / 1e6:.2f} million" for batch in BATCHES))
    built = construction(arguments.large_rows, arguments.repeats)
    reached = positions(arguments.large_rows, 1)
    large = Table("", "seconds", title=f"{arguments.large_rows:,} rows")
    for kind, took in built.items():
        large.add_row(f"construction, task as {kind}", f"{took:.2f}")
    for name, took in reached.items():
        large.add_row(name, f"{took:.2f}")
    limit = torch_limit(arguments.large_rows)

    default = found[next(iter(VARIANTS))]
    slowest = min(default.values())
    longest = max(built.values())
    targets = [
        target(
            "indices a second, batch 8 and 256", "1 million", f"{slowest / 1e6:.2f} million", slowest >= WANTED_PER_S
        ),
        target(
            f"construction for {arguments.large_rows:,} rows",
            f"under {WANTED_CONSTRUCTION_S:g} s",
            f"{longest:.2f} s",
            longest < WANTED_CONSTRUCTION_S,
        ),
    ]
    notes = [f"torch's sampler of {arguments.large_rows:,} rows: {limit}"]
    numbers = {"indices_per_second": found, "construction_s": built, "first_batch_s": reached, "torch_limit": limit}
    return finish(arguments, "sampler", [speed, large], targets, notes, numbers)


if __name__ == "__main__":
    raise SystemExit(main())
