"""The questions of a step, in batches: all are observed into the cache, then the policy is asked.

Its answers are on disk before what comes of them is.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluator.protocol import FAULT_CHECK, FAULT_LIMIT, FLIP_LIMIT
from evaluator.rollout.ask import record_answers
from evaluator.rollout.backend import Backend, PolicyProcess
from evaluator.run.records import Ledger, Records
from evaluator.runner.observation_cache import Block, ObservationCache
from evaluator.sim.observation import observation_sha256
from evaluator.statistics import clopper_pearson
from rema_data.errors import IntegrityError, PolicyFailureError
from rema_data.progress import Progress
from rema_data.schema import Scenario, Situation

__all__ = ["Batch", "batches", "check_faults", "infer_batches", "observe_batches", "shuffled"]

_BLOCK = 512


@dataclass(frozen=True, slots=True)
class Batch:
    """One question to the policy: ``rows`` of one ``block`` of the cache, which all questions of it share."""

    indices: tuple[int, ...]  # of the scenarios, in the order in which the policy is asked about them
    block: tuple[Situation, ...]  # names it in the cache
    rows: tuple[int, ...]

    @property
    def situations(self) -> tuple[Situation, ...]:
        """Situations of this batch."""
        return tuple(self.block[row] for row in self.rows)


def batches(alive: Mapping[int, Situation], batch_size: int) -> list[Batch]:
    """The questions of one step: fixed by the order of the scenarios in ``alive``, independent of earlier answers."""
    indices, situations = tuple(alive), tuple(alive.values())
    size = batch_size * max(1, _BLOCK // batch_size)
    found = []
    for start in range(0, len(indices), size):
        block = situations[start : start + size]
        for row in range(0, len(block), batch_size):
            rows = tuple(range(row, min(row + batch_size, len(block))))
            found.append(Batch(tuple(indices[start + one] for one in rows), block, rows))
    return found


def shuffled(wanted: Sequence[Batch], salt: str) -> list[Batch]:
    """The same questions in an order that only the run knows: no policy can identify a scenario by counting.

    Batches stay whole, and those of one block together. ``salt`` is drawn for the run; a resume keeps the order.
    """

    def rank(what: object) -> bytes:
        return hashlib.blake2b(repr(what).encode(), digest_size=16, key=salt.encode()).digest()

    def mixed(batch: Batch) -> Batch:
        pairs = sorted(zip(batch.indices, batch.rows, strict=True), key=lambda pair: rank(pair[0]))
        return Batch(tuple(index for index, _ in pairs), batch.block, tuple(row for _, row in pairs))

    in_order = sorted(_by_block(wanted), key=lambda batches: rank(batches[0].block[0]))
    return [mixed(one) for batches in in_order for one in sorted(batches, key=lambda batch: rank(batch.indices[0]))]


def _by_block(wanted: Sequence[Batch]) -> list[list[Batch]]:
    """Questions of the same block together. A block is known by its place in memory: comparing takes long."""
    blocks: dict[int, list[Batch]] = {}
    for batch in wanted:
        blocks.setdefault(id(batch.block), []).append(batch)
    return list(blocks.values())


def observe_batches(cache: ObservationCache, wanted: Sequence[Batch], progress: Progress) -> None:
    """Put the blocks of ``wanted`` into the cache, one at a time; those of a suite are compared with the frozen maps.

    An IntegrityError ends it at the first block that leaves no doubt that this machine makes other maps.
    """
    blocks = [batches[0].block for batches in _by_block(wanted)]
    progress.phase("observe", sum(len(block) for block in blocks))
    compared = others = 0
    for block in blocks:
        cache.ensure(block)
        if frozen := {row: seen for row, one in enumerate(block) if (seen := _frozen(one))}:
            found = cache.load(block)
            compared += len(frozen)
            others += sum(observation_sha256(found.observation(row)) != seen for row, seen in frozen.items())
            if clopper_pearson(others, compared)[0] > FLIP_LIMIT:
                raise _other_maps(others, compared)
        progress.advance(len(block))
    if others > FLIP_LIMIT * compared:
        raise _other_maps(others, compared)
    if others:
        progress.note(f"{others:,} of {compared:,} observations differ from the frozen ones, by rounding")


def _frozen(situation: Situation) -> str:
    """sha256 of the maps that its list was frozen with; clean lists do not say."""
    return "" if situation.variation is None else situation.variation.seen


def _other_maps(others: int, compared: int) -> IntegrityError:
    return IntegrityError(
        f"{others:,} of {compared:,} observations are not those that the suite was frozen with",
        hint="this machine works the noise out differently: use the numpy and scipy that rema was released with",
        others=others,
        compared=compared,
    )


def infer_batches(
    policy: PolicyProcess,
    backend: Backend,
    cache: ObservationCache,
    wanted: Sequence[Batch],
    ledger: Ledger,
    scenarios: Sequence[Scenario],
    progress: Progress,
) -> None:
    """Ask the policy about the batches of one step and record its answers; ``check_faults`` as it goes."""
    progress.phase("infer", sum(len(batch.indices) for batch in wanted))
    block: Block | None = None
    loaded: tuple[Situation, ...] = ()
    for batch in wanted:
        if block is None or loaded is not batch.block:
            block, loaded = cache.load(batch.block), batch.block
        observations = [block.observation(row) for row in batch.rows]
        record_answers(policy, backend, batch.indices, batch.situations, ledger, observations)
        progress.advance(len(batch.indices))
        if len(ledger.answers) >= FAULT_CHECK:
            check_faults(ledger, scenarios)


def check_faults(ledger: Records, scenarios: Sequence[Scenario]) -> None:
    """Raise a PolicyFailureError where the policy failed on more answers than a run allows.

    It has the first fault, and where the scenarios are those of a suite, how many each axis had.
    """
    faults = ledger.faults
    if len(faults) <= FAULT_LIMIT * len(ledger.answers):
        return
    first = faults[0]
    axes = Counter(one.axis for fault in faults if (one := scenarios[fault.index].variation) is not None)
    by_axis = f"; by axis: {', '.join(f'{axis} {count}' for axis, count in axes.most_common())}" if axes else ""
    raise PolicyFailureError(
        f"the policy failed on {len(faults)} of {len(ledger.answers)} observations (limit {FAULT_LIMIT:.0%}); "
        f"the first time on scenario {first.index}: {first.reason}: {first.detail}{by_axis}",
        hint="fix the policy and evaluate it into a new folder (--output); what was recorded stays in this one",
        faults=len(faults),
        answered=len(ledger.answers),
        reason=first.reason,
    )
