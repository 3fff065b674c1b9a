"""A policy as the ``Picker`` of scenario lists: situations to the outcomes of its actions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from evaluator.engines import InfraError, Job, make_engine
from evaluator.policy import PolicyFault, PolicySpec
from evaluator.rollout.ask import actions, ask
from evaluator.rollout.backend import Backend, check_digest, default_backend
from evaluator.run.plan import job_batches
from evaluator.scenarios.policy_picks import Picker
from rema_data.errors import InfrastructureError, PolicyFailureError
from rema_data.schema import Situation, StepOutcome

__all__ = ["BATCH", "open_picker"]

BATCH = 64
"""Observations in one question to the policy; with the size of a chunk it belongs to the identity of a list."""


@contextmanager
def open_picker(
    spec: PolicySpec, checkpoint: Path | None, device: str, log: Path, workers: int, backend: Backend | None = None
) -> Iterator[Picker]:
    """A policy that picks tools, in a process that prints into ``log``; SubmissionError if it cannot be loaded."""
    world = backend or default_backend()
    with (
        closing(make_engine("process", workers, world.simulator)) as engine,
        world.open_policy(spec, checkpoint, device, log, None) as policy,
    ):

        def carry_out(situations: Sequence[Situation]) -> list[StepOutcome]:
            task, step = situations[0].task, situations[0].step

            def no_action(position: int, fault: PolicyFault) -> PolicyFailureError:
                return PolicyFailureError(
                    f"the policy gave no action for step {step} of {task}: {fault.reason}: {fault.detail}",
                    hint="fix the policy, or draw the lists with another one",
                )

            chosen: list[int] = []
            for start in range(0, len(situations), BATCH):
                chosen += actions(ask(policy, world, situations[start : start + BATCH]), no_action)
            jobs = [Job(n, *pair) for n, pair in enumerate(zip(situations, chosen, strict=True))]
            outcomes: dict[int, StepOutcome] = {}
            for result in (result for results in engine.map(job_batches(jobs)) for result in results):
                if isinstance(result.outcome, InfraError):
                    raise InfrastructureError(
                        f"step {step} of {task} was lost: {result.outcome.detail}", hint="run the same command again"
                    )
                outcomes[result.key] = result.outcome
            return [outcomes[n] for n in range(len(situations))]

        recorded = world.policy_digest(spec, checkpoint)
        check_digest(policy, spec.name, recorded)
        yield Picker(spec.name, recorded, carry_out)
