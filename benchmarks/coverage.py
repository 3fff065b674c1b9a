"""Do the statistics keep what they promise? Coverage of the intervals, and wrong claims of the tests.

    python benchmarks/coverage.py
    python benchmarks/coverage.py --sizes 50,200 --rates 49 --pairs 300 --draws 100     # a look

Coverage of an interval of one rate, the level of the paired test and the level of the early stop are sums over all
outcomes, so they are exact. The paired interval, looking again and again with an ordinary test, and intervals at every
look are simulated, from keyed generators.
"""

from __future__ import annotations

import argparse
import bisect
import math
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import numpy.typing as npt
from rich.table import Table
from scipy.stats import binom

from benchmarks.results import finish, parser, target
from evaluator.statistics import (
    PairTable,
    clopper_pearson,
    difference_sequence,
    log_e_value,
    midp_mcnemar,
    paired_interval,
    rate_interval,
    rate_sequence,
    wilson,
)

WANTED = (0.94, 0.965)
LEVEL = 0.05
INTERVALS: dict[str, Callable[[int, int], tuple[float, float]]] = {
    "Wilson": wilson,
    "as printed (Clopper-Pearson at 0 and 1)": rate_interval,
    "Clopper-Pearson": clopper_pearson,
}
DISCORDANCES = (0.02, 0.1, 0.3)
CELLS = ((0.5, 0.06, 0.04, 0.4), (0.9, 0.02, 0.02, 0.06), (0.02, 0.03, 0.02, 0.93), (0.25, 0.25, 0.25, 0.25))
"""True shares of the pairs: both, only A, only B, neither."""
LOOKS = (1, 5, 20)
SEED = 11

Reals = npt.NDArray[np.float64]


def coverage(interval: Callable[[int, int], tuple[float, float]], n: int, rates: Reals) -> Reals:
    """Exact chance that the interval of ``n`` episodes holds the true rate, for every rate."""
    ends = np.array([interval(k, n) for k in range(n + 1)])
    # Both ends grow with the count: a rate is held by a run of counts.
    first = np.searchsorted(ends[:, 1], rates, side="left")
    last = np.searchsorted(ends[:, 0], rates, side="right") - 1
    held: Reals = binom.cdf(last, n, rates) - binom.cdf(first - 1, n, rates)
    return held


def rate_rows(sizes: Sequence[int], rates: Reals) -> list[dict[str, Any]]:
    """Coverage by kind of interval and number of episodes."""
    rows = []
    for kind, interval in INTERVALS.items():
        for n in sizes:
            held = coverage(interval, n, rates)
            inside = (held >= WANTED[0]) & (held <= WANTED[1])
            rows.append(
                {
                    "interval": kind,
                    "n": n,
                    "least": float(held.min()),
                    "least_at": float(rates[held.argmin()]),
                    "most": float(held.max()),
                    "most_at": float(rates[held.argmax()]),
                    "mean": float(held.mean()),
                    "inside": float(inside.mean()),
                    "outside": [
                        [float(rate), float(share)] for rate, share in zip(rates[~inside], held[~inside], strict=True)
                    ],
                }
            )
    return rows


def middle(row: dict[str, Any]) -> str:
    """The widest range of rates around one half in which the coverage is within the target everywhere."""
    distances = [abs(rate - 0.5) for rate, _ in row["outside"]]
    if not distances:
        return "everywhere"
    nearest = min(distances)
    return "nowhere" if nearest == 0 else f"{0.5 - nearest:.3f} < p < {0.5 + nearest:.3f}"


def midp_level(n: int, discordance: float) -> float:
    """Exact chance that the paired test calls two equally good policies different."""
    wrong = 0.0
    counts = np.arange(n + 1)
    weights = binom.pmf(counts, n, discordance)
    for discordant in counts[weights > 1e-9].tolist():
        # The p value grows with the smaller side: the first that makes no claim is found by halving.
        sides = range(discordant // 2 + 1)
        fewest = bisect.bisect(sides, LEVEL, key=lambda b, m=discordant: midp_mcnemar(PairTable(0, b, m - b, n - m)))
        wrong += float(weights[discordant]) * min(1.0, 2 * float(binom.cdf(fewest - 1, discordant, 0.5)))
    return wrong


def paired_coverage(n: int, cells: Sequence[float], draws: int) -> float:
    """Simulated chance that the paired interval holds the true difference."""
    generator = np.random.default_rng([SEED, n, round(1000 * cells[1])])
    truth, held = cells[1] - cells[2], 0
    for row in generator.multinomial(n, cells, draws).tolist():
        low, high = paired_interval(PairTable(*row))
        held += low <= truth <= high
    return held / draws


def early_stop_level(pairs: int) -> float:
    """Exact chance that the e-process ever stops within so many discordant pairs, without a difference."""
    alive, stopped = np.ones(1), 0.0
    for count in range(1, pairs + 1):
        alive = (np.append(alive, 0.0) + np.append(0.0, alive)) / 2
        ours = np.arange(count + 1)
        crossed = log_e_value(ours, count - ours) >= -math.log(LEVEL)
        stopped += float(alive[crossed].sum())
        alive[crossed] = 0.0
    return stopped


@lru_cache(maxsize=1_000_000)
def _claims(only_a: int, only_b: int) -> bool:
    return midp_mcnemar(PairTable(1, only_a, only_b, 0)) <= LEVEL


def looking(pairs: int, discordance: float, draws: int) -> dict[str, float]:
    """Simulated shares of runs of two equal policies with a claim, by ordinary tests at looks and by the e-process."""
    generator = np.random.default_rng([SEED, pairs, round(1000 * discordance)])
    found = dict.fromkeys([*(f"{looks} looks" for looks in LOOKS), "e-process"], 0)
    for _ in range(draws):
        differs = generator.random(pairs) < discordance
        only_a = np.cumsum(differs & (generator.random(pairs) < 0.5))
        only_b = np.cumsum(differs) - only_a
        for looks in LOOKS:
            at = [pairs * look // looks - 1 for look in range(1, looks + 1)]
            found[f"{looks} looks"] += any(_claims(int(only_a[place]), int(only_b[place])) for place in at)
        found["e-process"] += bool((log_e_value(only_a, only_b) >= -math.log(LEVEL)).any())
    return {name: count / draws for name, count in found.items()}


def sequence_misses(pairs: int, cells: Sequence[float], draws: int) -> dict[str, float]:
    """Simulated shares of runs in which an interval for every look missed the truth at any of twelve looks."""
    generator = np.random.default_rng([SEED, pairs, round(1000 * cells[1]), 2])
    looks = np.unique(np.geomspace(min(10, pairs), pairs, 12).astype(int))
    missed = {"rate": 0, "difference": 0}
    for _ in range(draws):
        drawn = generator.choice(4, pairs, p=cells)
        counts = [np.bincount(drawn[:n], minlength=4).tolist() for n in looks]
        rates = [rate_sequence(a + b, int(n)) for n, (a, b, _, _) in zip(looks, counts, strict=True)]
        spans = [difference_sequence(b, c, int(n)) for n, (_, b, c, _) in zip(looks, counts, strict=True)]
        missed["rate"] += any(not low <= cells[0] + cells[1] <= high for low, high in rates)
        missed["difference"] += any(not low <= cells[1] - cells[2] <= high for low, high in spans)
    return {name: count / draws for name, count in missed.items()}


def percent(share: float) -> str:
    """A share in per cent, two decimals."""
    return f"{100 * share:.2f}"


def tables(numbers: dict[str, Any]) -> list[Table]:
    """Everything, for people."""
    one = Table("interval", "n", "least, %", "at p", "most, %", "at p", "mean, %", "rates within, %", "within for")
    one.title = (
        f"coverage of the 95 % interval of one rate (exact); within: {100 * WANTED[0]:g} to {100 * WANTED[1]:g} %"
    )
    for row in numbers["rates"]:
        cells = [percent(row["least"]), f"{row['least_at']:.3f}", percent(row["most"]), f"{row['most_at']:.3f}"]
        one.add_row(row["interval"], f"{row['n']:,}", *cells, percent(row["mean"]), percent(row["inside"]), middle(row))
    level = Table("n", "discordance", "wrong claims, %", title="mid-p McNemar at 5 %, equal policies (exact)")
    for row in numbers["midp"]:
        level.add_row(f"{row['n']:,}", f"{row['discordance']:g}", percent(row["level"]))
    paired = Table("n", "both, only A, only B, neither", "coverage, %", title="the paired 95 % interval (simulated)")
    for row in numbers["paired"]:
        paired.add_row(f"{row['n']:,}", ", ".join(map(str, row["cells"])), percent(row["coverage"]))
    again = Table("discordance", *(f"mid-p, {looks} looks" for looks in LOOKS), "e-process, every pair")
    again.title = f"wrong claims about equal policies within {numbers['pairs']:,} pairs, % (simulated)"
    for row in numbers["looking"]:
        shares = [row["wrong"][name] for name in [*(f"{looks} looks" for looks in LOOKS), "e-process"]]
        again.add_row(f"{row['discordance']:g}", *map(percent, shares))
    every = Table("both, only A, only B, neither", "rate, %", "difference, %")
    every.title = (
        f"runs of {numbers['pairs']:,} pairs whose interval for every look missed the truth at a look (simulated)"
    )
    for row in numbers["sequences"]:
        every.add_row(
            ", ".join(map(str, row["cells"])), percent(row["missed"]["rate"]), percent(row["missed"]["difference"])
        )
    return [one, level, paired, again, every]


def main() -> int:
    """Compute, print, and write what was asked for."""
    options = parser(__doc__)
    options.add_argument(
        "--sizes", type=_numbers, default=[50, 100, 200, 500, 1000, 2000, 5000, 10_000], help="episodes"
    )
    options.add_argument("--rates", type=int, default=999, help="so many true rates between 0 and 1, evenly")
    options.add_argument("--pairs", type=int, default=10_000, help="longest paired run")
    options.add_argument("--draws", type=int, default=2000, help="simulated runs for each line")
    arguments = options.parse_args()
    numbers = measure(arguments)
    worst = [row for row in numbers["rates"] if row["interval"] == "Wilson"]
    least, most = min(row["least"] for row in worst), max(row["most"] for row in worst)
    quick = numbers["early_stop_level"]
    simulated = max(row["wrong"]["e-process"] for row in numbers["looking"])
    noise = 3 * math.sqrt(LEVEL * (1 - LEVEL) / arguments.draws)
    found = [
        target(
            "coverage of Wilson, %",
            f"{100 * WANTED[0]:g} to {100 * WANTED[1]:g}",
            f"{percent(least)} to {percent(most)}",
            WANTED[0] <= least and most <= WANTED[1],
        ),
        target("wrong claims of the early stop, exact, %", "under 5", percent(quick), quick < LEVEL),
        target("the same, simulated, %", f"under 5 + {percent(noise)}", percent(simulated), simulated < LEVEL + noise),
    ]
    notes = [
        "Counts are whole numbers, so where few successes or few failures are expected, no interval has a coverage of "
        "exactly 95 %. The last column gives the rates between which the coverage is within the target throughout.",
        f"The exact level of the early stop is for {numbers['early_stop_pairs']:,} discordant pairs.",
    ]
    return finish(arguments, "coverage", tables(numbers), found, notes, numbers)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All numbers, JSON-ready."""
    sizes, pairs, draws = arguments.sizes, arguments.pairs, arguments.draws
    rates = np.linspace(0, 1, arguments.rates + 2)[1:-1]
    tested = [n for n in sizes if n <= pairs and n >= 100] or [pairs]
    return {
        "pairs": pairs,
        "draws": draws,
        "early_stop_pairs": pairs,
        "rates": rate_rows(sizes, rates),
        "midp": [
            {"n": n, "discordance": psi, "level": midp_level(n, psi)}
            for n in dict.fromkeys((tested[0], tested[-1]))
            for psi in DISCORDANCES
        ],
        "paired": [
            {"n": n, "cells": list(cells), "coverage": paired_coverage(n, cells, draws)}
            for n in dict.fromkeys((tested[0], tested[-1]))
            for cells in CELLS
        ],
        "early_stop_level": early_stop_level(pairs),
        "looking": [{"discordance": psi, "wrong": looking(pairs, psi, draws)} for psi in DISCORDANCES],
        "sequences": [
            {"cells": list(cells), "missed": sequence_misses(pairs, cells, max(1, draws // 10))} for cells in CELLS[:2]
        ],
    }


def _numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


if __name__ == "__main__":
    sys.exit(main())
