"""Phase two of a step: the policy is asked in batches, and what it said is on disk before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from evaluator.policy import ObservationBatch, PolicyFault
from evaluator.protocol import FAULT_LIMIT
from evaluator.rollout.backend import PolicyProcess
from evaluator.run.records import Answered, Ledger
from evaluator.runner.observation_cache import Block, ObservationBank
from evaluator.runner.observe import Batch
from rema_data.errors import PolicyFailureError
from rema_data.progress import Progress
from rema_data.schema import Situation

__all__ = ["FAULT_CHECK", "check_faults", "infer_batches"]

FAULT_CHECK = 100
"""The share is looked at while the policy is asked once so many answers are there, and at the end in any case."""


def infer_batches(
    policy: PolicyProcess,
    bank: ObservationBank,
    wanted: Sequence[Batch],
    valid: npt.NDArray[np.bool_],
    ledger: Ledger,
    progress: Progress,
) -> None:
    """Ask the policy about ``wanted`` and record its answers.

    Parameters
    ----------
    policy : PolicyProcess
    bank : ObservationBank
    wanted : sequence of Batch
        Of one step.
    valid : bool (64, 64, 16)
    ledger : Ledger
    progress : Progress

    Raises
    ------
    PolicyFailureError
        Too many answers are faults.
    StorageError
        The disk is full.
    """
    progress.phase("infer", sum(len(batch.indices) for batch in wanted))
    block: Block | None = None
    loaded: tuple[Situation, ...] = ()
    for batch in wanted:
        if block is None or loaded is not batch.block:
            block, loaded = bank.load(batch.block), batch.block
        situations = batch.situations
        step = situations[0].step
        question = ObservationBatch.of_maps(situations[0], *block.arrays(batch.rows), valid)
        answers = policy.act(question, situations if policy.privileged else None)
        ledger.add_answers(
            Answered(index, step, None, str(answer.reason), answer.detail)
            if isinstance(answer, PolicyFault)
            else Answered(index, step, int(answer))
            for index, answer in zip(batch.indices, answers, strict=True)
        )
        progress.advance(len(batch.indices))
        if len(ledger.answers) >= FAULT_CHECK:
            check_faults(ledger)


def check_faults(ledger: Ledger) -> None:
    """Raise where the policy failed on more episodes than a run tolerates.

    Raises
    ------
    PolicyFailureError
        With the first fault as an example.
    """
    faults = [answer for answer in ledger.answers.values() if answer.action is None]
    if len(faults) <= FAULT_LIMIT * len(ledger.answers):
        return
    first = faults[0]
    raise PolicyFailureError(
        f"the policy failed on {len(faults)} of {len(ledger.answers)} observations (limit {FAULT_LIMIT:.0%}); "
        f"the first time on scenario {first.index}: {first.reason}: {first.detail}",
        hint="mend the policy and evaluate it into a new folder (--output); what was recorded stays in this one",
        faults=len(faults),
        answered=len(ledger.answers),
        reason=first.reason,
    )
