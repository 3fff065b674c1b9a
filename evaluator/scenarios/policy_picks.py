"""Scenario lists whose tools a policy picked: what a learned picker leaves in the hand, instead of the reference pick.

The objects are those of the reference lists, drawn by the same generators. One that the policy fails to pick is drawn
again, as there; a pinch (``grasp_grasp_push``) is still the reference one. Where it fails on many objects, the tools
are drawn and picked again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from evaluator.engines import Engine, InfraError, Job
from evaluator.policy import ObservationBatch, PolicyFault
from evaluator.rollout.backend import Backend, PolicyProcess
from evaluator.run.plan import shards
from evaluator.sim.reference import reference_step
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import draw_episode, draw_step
from rema_data.errors import InfrastructureError, PolicyFailureError
from rema_data.schema import Grip, Pinch, Placement, Scenario, Situation, StepOutcome, pinch_step, tool_steps

__all__ = ["Picked", "draw_picked"]

BATCH = 64
"""Observations in one question to the policy."""
LIMIT = 200
"""Objects that are drawn for one tool at most: a policy that cannot pick is an error, not a long wait."""


@dataclass(slots=True)
class Picked:
    """A scenario that is being drawn.

    Attributes
    ----------
    index : int
    rng : numpy.random.Generator
        Of the episode.
    placements : list of Placement
    grips : tuple of Grip
    pinch : Pinch or None
    redrawn : int
        Objects that were drawn again.
    """

    index: int
    rng: np.random.Generator
    placements: list[Placement]
    grips: tuple[Grip, ...] = ()
    pinch: Pinch | None = None
    redrawn: int = 0

    def begin_anew(self, task: str) -> None:
        """Draw all objects again, for empty hands."""
        self.placements, self.grips, self.pinch = list(draw_episode(self.rng, task)), (), None
        self.redrawn += len(self.placements)

    def scenario(self, task: str, split: str) -> Scenario:
        """The finished scenario."""
        return Scenario(task, split, self.index, tuple(self.placements), self.grips, self.pinch)


def draw_picked(
    task: str,
    generators: dict[int, np.random.Generator],
    policy: PolicyProcess,
    engine: Engine,
    pool: Executor,
    backend: Backend,
) -> list[Picked]:
    """Draw some scenarios of a task, in the order of their indices; a function of the indices and the policy alone.

    Parameters
    ----------
    task : str
    generators : dict of int to numpy.random.Generator
        Of every scenario, by its index.
    policy : PolicyProcess
        Picks the tools.
    engine : Engine
        Simulates the picks.
    pool : Executor
        Runs the reference pinches.
    backend : Backend

    Raises
    ------
    PolicyFailureError
        The policy gave no action, or failed on too many objects in a row.
    InfrastructureError
        A worker died twice on the same pick.
    """
    drawn = [Picked(index, rng, list(draw_episode(rng, task))) for index, rng in sorted(generators.items())]
    waiting = drawn
    for _ in range(LIMIT):
        for step in tool_steps(task):
            if failed := _failed(waiting, partial(_pick, task, step, policy, engine, backend), task, step):
                raise _cannot(task, step, failed[0], "draw the lists with a policy that can pick tools")
        pinched = pinch_step(task)
        if pinched is None:
            return drawn
        step = pinched
        waiting = _failed(waiting, partial(_pinch, task, step, pool), task, step)
        if not waiting:
            return drawn
        for one in waiting:  # its tools lie so in the hands that nothing can be held between them
            one.begin_anew(task)
    raise _cannot(task, step, waiting[0], "draw the lists with a policy whose picks leave the tools free")


def _failed(
    drawn: Sequence[Picked], attempt: Callable[[list[Picked]], list[bool]], task: str, step: int
) -> list[Picked]:
    """Try every scenario's object, and draw those that failed again; the scenarios that failed on ``LIMIT`` of them."""
    waiting = list(drawn)
    for _ in range(LIMIT):
        won = attempt(waiting)
        waiting = [one for one, good in zip(waiting, won, strict=True) if not good]
        if not waiting:
            break
        for one in waiting:
            one.placements[step] = draw_step(one.rng, task, step)
            one.redrawn += 1
    return waiting


def _cannot(task: str, step: int, one: Picked, hint: str) -> PolicyFailureError:
    return PolicyFailureError(
        f"step {step} of {task} failed on {LIMIT} objects in a row for scenario {one.index}",
        hint=hint,
        task=task,
        step=step,
    )


def _pick(
    task: str, step: int, policy: PolicyProcess, engine: Engine, backend: Backend, some: list[Picked]
) -> list[bool]:
    situations = [Situation(task, step, one.placements[step], one.grips) for one in some]
    actions = [action for part in _parts(situations) for action in _ask(task, step, part, policy, backend)]
    jobs = [Job(n, situation, action) for n, (situation, action) in enumerate(zip(situations, actions, strict=True))]
    outcomes: dict[int, StepOutcome] = {}
    for results in engine.map(iter(shards(jobs))):
        for result in results:
            if isinstance(result.outcome, InfraError):
                raise InfrastructureError(
                    f"a pick of scenario {some[result.key].index} of {task} was lost: {result.outcome.detail}",
                    hint="run the same command again",
                )
            outcomes[result.key] = result.outcome
    for n, one in enumerate(some):
        grip = outcomes[n].grip
        if outcomes[n].success and grip is not None:
            one.grips = (*one.grips, grip)
    return [outcomes[n].success for n in range(len(some))]


def _parts(situations: Sequence[Situation]) -> Iterator[Sequence[Situation]]:
    for start in range(0, len(situations), BATCH):
        yield situations[start : start + BATCH]


def _ask(
    task: str, step: int, situations: Sequence[Situation], policy: PolicyProcess, backend: Backend
) -> Iterator[int]:
    seen = [backend.observe(situation) for situation in situations]
    question = ObservationBatch.of(situations[0], seen, backend.valid_actions(task, step))
    for answer in policy.act(question, tuple(situations) if policy.privileged else None):
        if isinstance(answer, PolicyFault):
            raise PolicyFailureError(
                f"the policy gave no action for step {step} of {task}: {answer.reason}: {answer.detail}",
                hint="mend the policy, or draw the lists with another",
            )
        yield answer


_simulator: Simulator | None = None


def _pinch_one(situation: Situation, rng: np.random.Generator) -> Pinch | None:
    """In a worker of the pool."""
    global _simulator
    if _simulator is None:
        _simulator = Simulator()
    outcome = reference_step(_simulator, situation, rng)
    return None if outcome is None else outcome.pinch


def _pinch(task: str, step: int, pool: Executor, some: list[Picked]) -> list[bool]:
    situations = [Situation(task, step, one.placements[step], one.grips) for one in some]
    pinches = pool.map(_pinch_one, situations, [one.rng for one in some], chunksize=25)
    for one, pinch in zip(some, pinches, strict=True):
        one.pinch = pinch
    return [one.pinch is not None for one in some]
