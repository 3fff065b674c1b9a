"""The determinism audit: 1 % of a run is repeated in other conditions.

The policy is asked again in a new process, in batches of other sizes and companions; the recorded actions are simulated
again in a new process, in another order. A policy that remembers earlier questions or answers by position shows as
action flips, a world that is not a pure function as outcome flips.

Which episodes are repeated depends on a digest of everything that was recorded before: they cannot be known earlier.
The repeats are journals of their own, in ``records/audit``, so that an interrupted audit continues where it stopped.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from evaluator.engines import Job
from evaluator.protocol import AUDIT_LEAST
from evaluator.rollout.ask import record_answers
from evaluator.rollout.backend import Backend, PolicyProcess
from evaluator.run.plan import Plan
from evaluator.run.records import Ledger, Records, same_outcome
from evaluator.run.tables import verdict
from evaluator.statistics import clopper_pearson
from rema_data.schema import Situation, StepOutcome

__all__ = ["Repeat", "ask_again", "audit_summary", "jobs_again", "repeats", "seed_of"]

_BATCHES = (24, 40)
"""Observations in one question: the first of these that is not the run's own batch size."""
_KEY = b"rema audit v2"
_FLIPS_NAMED = 10


@dataclass(frozen=True, slots=True)
class Repeat:
    """One step of one episode that is done again."""

    index: int
    step: int
    situation: Situation


def seed_of(*sealed: bytes) -> bytes:
    """What a sample is drawn with: the same for the same run, and not known before it was played.

    ``sealed`` is what was recorded before the sample is drawn, in an order that does not depend on how it was computed.
    """
    total = hashlib.sha256()
    for content in sealed:
        total.update(hashlib.sha256(content).digest())
    return total.digest()


def repeats(plan: Plan, ledger: Records, share: float, seed: bytes) -> list[Repeat]:
    """Every step of a share of the measured episodes, drawn with a seed (``seed_of``), in the order of the draw."""
    measured = [s.index for s in plan.scenarios if verdict(s.index, plan.steps, ledger).success is not None]
    ranked = sorted(measured, key=lambda index: _rank(index, seed))
    chosen = set(ranked[: max(AUDIT_LEAST, math.ceil(share * len(measured)))] if share else ())
    found = []
    for step in plan.steps:
        alive = plan.alive(step, ledger)
        found += [Repeat(index, step, alive[index]) for index in ranked if index in chosen and index in alive]
    return found


def _rank(index: int, seed: bytes) -> bytes:
    return hashlib.blake2b(seed + index.to_bytes(8, "big"), digest_size=16, key=_KEY).digest()


def ask_again(
    policy: PolicyProcess, backend: Backend, wanted: Iterable[Repeat], batch_size: int, again: Ledger
) -> Iterator[int]:
    """Ask a fresh policy about ``wanted``, in batches of another size than ``batch_size``; record in ``again``.

    Yields the number of observations answered just now.
    """
    size = next(size for size in _BATCHES if size != batch_size)
    by_step: dict[int, list[Repeat]] = {}
    for repeat in wanted:
        if (repeat.index, repeat.step) not in again.answers:
            by_step.setdefault(repeat.step, []).append(repeat)
    for of_step in by_step.values():
        for start in range(0, len(of_step), size):
            batch = of_step[start : start + size]
            indices, situations = [one.index for one in batch], [one.situation for one in batch]
            record_answers(policy, backend, indices, situations, again)
            yield len(batch)


def jobs_again(wanted: Sequence[Repeat], ledger: Records, again: Records) -> list[Job]:
    """The recorded actions of ``wanted`` that have no repeated outcome yet; a job's key is its position there."""
    jobs = []
    for position, repeat in enumerate(wanted):
        answer = ledger.answers[repeat.index, repeat.step]
        done = again.outcomes.get((repeat.index, repeat.step))
        if answer.action is not None and (done is None or not isinstance(done.outcome, StepOutcome)):
            jobs.append(Job(position, repeat.situation, answer.action))
    return jobs


def audit_summary(wanted: Sequence[Repeat], ledger: Records, again: Records) -> dict[str, Any]:
    """How often the repeats differed, ready for JSON.

    ``actions`` asked again and ``action_flips`` among them, ``outcomes`` simulated again and ``outcome_flips`` (any bit
    of an outcome), each with its Clopper-Pearson interval; ``lost``, repeats without an outcome; ``flipped``, the first
    flips.
    """
    actions = outcomes = lost = action_flips = outcome_flips = 0
    flipped: list[dict[str, Any]] = []
    for repeat in wanted:
        key = (repeat.index, repeat.step)
        said, said_again = ledger.answers[key], again.answers.get(key)
        if said_again is not None:
            actions += 1
            if said.action != said_again.action:
                action_flips += 1
                flipped.append({"index": repeat.index, "step": repeat.step, "what": "action"})
        first, second = ledger.outcomes.get(key), again.outcomes.get(key)
        if said.action is None or first is None:
            continue
        if second is None or not isinstance(second.outcome, StepOutcome):
            lost += 1
            continue
        outcomes += 1
        if not same_outcome(first.outcome, second.outcome):
            outcome_flips += 1
            flipped.append({"index": repeat.index, "step": repeat.step, "what": "outcome"})
    return {
        "episodes": len({repeat.index for repeat in wanted}),
        "actions": actions,
        "action_flips": action_flips,
        "action_flips_ci95": list(clopper_pearson(action_flips, actions)),
        "outcomes": outcomes,
        "outcome_flips": outcome_flips,
        "outcome_flips_ci95": list(clopper_pearson(outcome_flips, outcomes)),
        "lost": lost,
        "flipped": flipped[:_FLIPS_NAMED],
    }
