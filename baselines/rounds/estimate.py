"""Expected time and size of a plan: a few episodes of every kind are played, measured, and thrown away.

They are the first episodes of the collection, so only the seconds differ from run to run.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from baselines.rounds.plan import BlockPlan, CollectionPlan, PolicyUse
from baselines.rounds.play import BehaviourPolicies, Player
from baselines.rounds.work import Chunk, encoded
from evaluator.engines import Engine, default_workers, engine_type, make_engine, worker_count
from evaluator.runner import Backend, default_backend
from evaluator.scenarios.varied import Vary
from rema_data.leftovers import temporary_folder
from rema_data.progress import Progress, Silent
from rema_data.schema import Episode
from rema_data.store.block import BlockWriter, encode_episodes

__all__ = ["Estimate", "estimate"]

PILOT = 16
"""Episodes that are played of every kind, besides two that warm up."""
_WARM_UP = 2

Kind = tuple[str, tuple[PolicyUse, ...], Vary | None]
"""Task, the policies of its steps, and what is varied: blocks of one kind take the same time an episode."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The seconds and bytes that a block is expected to take."""

    block: BlockPlan
    seconds: float
    bytes: int


@dataclass(frozen=True, slots=True)
class _Rates:
    """Measured on a pilot: seconds an episode inside and outside of simulators, and bytes as a line over episodes."""

    simulate_s: float
    rest_s: float
    start_bytes: float
    bytes: float


def estimate(
    plan: CollectionPlan,
    *,
    engine: str = "process",
    workers: int | None = None,
    address: str | None = None,
    progress: Progress | None = None,
    backend: Backend | None = None,
) -> list[Estimate]:
    """Expected seconds and bytes of every block of a plan, from a pilot in this process.

    Options and errors are those of ``collect``.
    """
    progress, backend = progress or Silent(), backend or default_backend()
    kinds: dict[Kind, BlockPlan] = {}
    for block in plan.blocks:
        kinds.setdefault(_kind(block), block)
    progress.phase("pilot", len(kinds) * (_WARM_UP + PILOT))
    rates: dict[Kind, _Rates] = {}
    with temporary_folder("rema-estimate-") as folder, ExitStack() as stack:
        policies = stack.enter_context(closing(BehaviourPolicies(plan.blocks, backend, folder)))
        policies.start(block.key for block in kinds.values())
        running = stack.enter_context(closing(make_engine("inline", factory=backend.simulator)))
        for kind, block in kinds.items():
            player = Player(plan.seed, backend, policies.of, {block.key: block.vary})
            rates[kind] = _measure(player, running, block, folder, progress)
    count = worker_count(engine, workers, address=address)
    place = engine_type(engine).place
    if place == "here":
        count = 0
    cores = count + 1 if place == "cluster" else default_workers()
    return [_expected(block, rates[_kind(block)], count, cores) for block in plan.blocks]


def _expected(block: BlockPlan, rates: _Rates, workers: int, cores: int) -> Estimate:
    """With so many worker processes beside this one, or none, where this process simulates too."""
    # However many workers there are, they and this process have no more than the cores.
    seconds = (rates.simulate_s + rates.rest_s) / min(workers + 1, cores)
    if workers:
        seconds = max(seconds, rates.rest_s, rates.simulate_s / workers)
    return Estimate(block, block.episodes * seconds, round(rates.start_bytes + block.episodes * rates.bytes))


def _kind(block: BlockPlan) -> Kind:
    return block.key.task, block.policies, block.vary


def _measure(player: Player, engine: Engine, block: BlockPlan, folder: Path, progress: Progress) -> _Rates:
    warm, timed = Chunk(block.key, 0, _WARM_UP), Chunk(block.key, _WARM_UP, _WARM_UP + PILOT)
    list(player.play([warm], engine, progress.advance))
    before, start = player.simulate_s, time.perf_counter()
    [(_, episodes)] = player.play([timed], engine, progress.advance)
    encoded(encode_episodes(episodes))
    total_s, simulate_s = time.perf_counter() - start, player.simulate_s - before
    half, whole = (_block_bytes(folder / f"{n}", episodes[:n]) for n in (PILOT // 2, PILOT))
    slope = (whole - half) / (PILOT - PILOT // 2)
    return _Rates(simulate_s / PILOT, (total_s - simulate_s) / PILOT, whole - PILOT * slope, slope)


def _block_bytes(folder: Path, episodes: Sequence[Episode]) -> int:
    """Size of a block that holds these episodes."""
    writer = BlockWriter(folder)
    writer.append(*encode_episodes(episodes))
    writer.close()
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    shutil.rmtree(folder)
    return size
