"""Phase two of a step: the policy is asked in batches, and what it said is on disk before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence

from evaluator.protocol import FAULT_CHECK, FAULT_LIMIT
from evaluator.rollout.ask import record_answers
from evaluator.rollout.backend import Backend, PolicyProcess
from evaluator.run.records import Ledger
from evaluator.runner.observation_cache import Block, ObservationCache
from evaluator.runner.observe import Batch
from rema_data.errors import PolicyFailureError
from rema_data.progress import Progress
from rema_data.schema import Situation

__all__ = ["check_faults", "infer_batches"]


def infer_batches(
    policy: PolicyProcess,
    backend: Backend,
    cache: ObservationCache,
    wanted: Sequence[Batch],
    ledger: Ledger,
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
            check_faults(ledger)


def check_faults(ledger: Ledger) -> None:
    """Raise a PolicyFailureError, with the first fault, where the policy failed on more answers than a run allows."""
    faults = [answer for answer in ledger.answers.values() if answer.action is None]
    if len(faults) <= FAULT_LIMIT * len(ledger.answers):
        return
    first = faults[0]
    raise PolicyFailureError(
        f"the policy failed on {len(faults)} of {len(ledger.answers)} observations (limit {FAULT_LIMIT:.0%}); "
        f"the first time on scenario {first.index}: {first.reason}: {first.detail}",
        hint="fix the policy and evaluate it into a new folder (--output); what was recorded stays in this one",
        faults=len(faults),
        answered=len(ledger.answers),
        reason=first.reason,
    )
