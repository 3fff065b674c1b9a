"""Asking a policy: observations of one step become a question, and its answers come back as actions or faults."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from evaluator.policy import Answer, ObservationBatch, PolicyFault
from evaluator.policy.faults import check_answer
from evaluator.rollout.backend import Backend, PolicyProcess
from evaluator.run.records import POLICY_FAULT, Answered, Ledger
from rema_data.errors import RemaError
from rema_data.schema import Observation, Situation, StepOutcome

__all__ = ["actions", "ask", "attempt", "question", "record_answers"]


def question(
    backend: Backend, situations: Sequence[Situation], observations: Sequence[Observation] | None = None
) -> ObservationBatch:
    """The question about some situations of one step of one task; ``observations`` where they are known already."""
    seen = [backend.observe(situation) for situation in situations] if observations is None else observations
    first = situations[0]
    return ObservationBatch.of(first, seen, backend.valid_actions(first.task, first.step))


def ask(
    policy: PolicyProcess,
    backend: Backend,
    situations: Sequence[Situation],
    observations: Sequence[Observation] | None = None,
) -> list[Answer]:
    """One valid grid index or fault for each situation, in order; only a privileged policy is shown the situations."""
    batch = question(backend, situations, observations)
    return policy.act(batch, tuple(situations) if policy.privileged else None)


def record_answers(
    policy: PolicyProcess,
    backend: Backend,
    indices: Sequence[int],
    situations: Sequence[Situation],
    ledger: Ledger,
    observations: Sequence[Observation] | None = None,
) -> None:
    """Ask about the situations of some scenarios, and record the answers under the indices of the scenarios."""
    step = situations[0].step
    ledger.add_answers(
        Answered(index, step, None, str(answer.reason), answer.detail)
        if isinstance(answer, PolicyFault)
        else Answered(index, step, int(answer))
        for index, answer in zip(indices, ask(policy, backend, situations, observations), strict=True)
    )


def actions(answers: Sequence[Answer], error: Callable[[int, PolicyFault], RemaError]) -> list[int]:
    """The answers, which must all be actions; ``error`` makes an exception of the first (position, fault)."""
    for position, answer in enumerate(answers):
        if isinstance(answer, PolicyFault):
            raise error(position, answer)
    return [int(answer) for answer in answers if not isinstance(answer, PolicyFault)]


def attempt(
    run: Callable[[Situation, int], StepOutcome], backend: Backend, situation: Situation, action: int
) -> StepOutcome:
    """Outcome of any grid index; ``run`` is ``Simulator.run``. An index that is not valid is a policy error."""
    valid = backend.valid_actions(situation.task, situation.step)
    (answer,) = check_answer(np.array([action]), valid[None])
    return POLICY_FAULT if isinstance(answer, PolicyFault) else run(situation, answer)
