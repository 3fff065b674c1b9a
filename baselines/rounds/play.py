"""Playing episodes: observe, ask the policy, simulate, step after step, with several chunks under way.

A chunk fixes which episodes are asked about together. So no answer depends on the number of workers, on which of them
is quick, or on what was played before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from baselines.rounds.plan import BlockPlan, PolicyUse
from baselines.rounds.work import Chunk
from evaluator.engines import Engine, InfraError, Job, JobBatch, JobResult
from evaluator.policy import PolicyFault
from evaluator.rollout.ask import actions, ask
from evaluator.rollout.backend import Backend, PolicyProcess, check_digest
from evaluator.rollout.episode import first_step, next_step
from evaluator.run.plan import job_batches
from evaluator.scenarios.varied import Vary, vary_episode
from evaluator.sim.spawn import collection_generator, draw_episode
from rema_data.errors import InfrastructureError, PolicyFailureError
from rema_data.schema import Action, Episode, Observation, Scenario, Situation, Step
from rema_data.store.block import BlockKey

__all__ = ["BATCH", "BehaviourPolicies", "Player", "draw_scenario"]

BATCH = 50
"""Observations in one question to a policy."""
_OPEN_CHUNKS = 4
"""Chunks under way at most: enough that no worker waits for the last episodes of another one's."""


def draw_scenario(seed: int, block: BlockKey, index: int, vary: Vary | None = None) -> Scenario:
    """One episode of a block: the objects of every step of its task, and what is varied."""
    rng = collection_generator(seed, block.round, block.task, block.split, index)
    clean = Scenario(block.task, block.split, index, draw_episode(rng, block.task))
    return clean if vary is None else vary_episode(clean, vary, rng)


class _Behaviour(NamedTuple):
    """A running policy; its name and digest are recorded with every step that it plays."""

    name: str
    digest: str
    process: PolicyProcess


class BehaviourPolicies:
    """The policies of some blocks, each in a process, alive from ``start`` to ``close``, with their ``digests``.

    Their output goes to files in ``logs``.
    """

    def __init__(self, blocks: Sequence[BlockPlan], backend: Backend, logs: Path) -> None:
        self._uses = {block.key: block.policies for block in blocks}
        self._backend, self._logs = backend, logs
        every = dict.fromkeys(use for block in blocks for use in block.policies)
        self.digests = {use: backend.policy_digest(use.spec, use.checkpoint) for use in every}
        self._running: dict[PolicyUse, _Behaviour] = {}
        self._stack = ExitStack()

    def start(self, blocks: Iterable[BlockKey]) -> None:
        """Start every policy that some blocks need; raises SubmissionError at once where one cannot be loaded."""
        for use in dict.fromkeys(use for block in blocks for use in self._uses[block]):
            log = self._logs / f"policy-{use.spec.name}-{self.digests[use][:8]}.log"
            process = self._stack.enter_context(
                self._backend.open_policy(use.spec, use.checkpoint, use.device, log, None)
            )
            check_digest(process, use.spec.name, self.digests[use])
            self._running[use] = _Behaviour(use.spec.name, self.digests[use], process)

    def of(self, block: BlockKey, step: int) -> _Behaviour:
        """The policy that plays a step of a block."""
        return self._running[self._uses[block][step]]

    def close(self) -> None:
        """Stop the policies."""
        self._running.clear()
        self._stack.close()


@dataclass(slots=True, eq=False)
class _Open:
    """A chunk under way: by episode its scenario, its finished steps, and the situation that comes next."""

    chunk: Chunk
    scenarios: dict[int, Scenario]
    steps: dict[int, list[Step]]
    due: dict[int, Situation]
    flying: int = 0  # outcomes of the present step that are still to come


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """A step whose action is known and whose outcome is not."""

    open: _Open
    index: int
    situation: Situation
    observation: Observation
    action: int
    behaviour: _Behaviour


_Question = tuple[_Open, Sequence[tuple[int, Situation]]]
"""Some episodes of a chunk, and the situations that their step starts from."""
_Answer = tuple[_Behaviour, list[Observation], list[int]]


class Player:
    """Plays chunks with an engine.

    ``seed`` is the root seed of the plan; ``behaviour`` maps (block, step) to a policy, and ``vary`` a block to what is
    varied in it; ``simulate_s`` counts the seconds inside simulators, over all workers.
    """

    def __init__(
        self,
        seed: int,
        backend: Backend,
        behaviour: Callable[[BlockKey, int], _Behaviour],
        vary: Mapping[BlockKey, Vary | None],
    ) -> None:
        self._seed, self._backend, self._behaviour, self._vary = seed, backend, behaviour, vary
        self._questions: deque[_Question] = deque()
        self._ready: deque[JobBatch] = deque()
        self._flying: dict[int, _Asked] = {}
        self._open = 0
        self._number = 0
        self.simulate_s = 0.0

    def play(
        self, chunks: Iterable[Chunk], engine: Engine, advance: Callable[[int], None]
    ) -> Iterator[tuple[Chunk, list[Episode]]]:
        """Play chunks and yield each as soon as it is done, in no fixed order.

        The engine stays open; ``advance`` is called with the number of newly finished episodes. Raises
        PolicyFailureError where a policy gave no action, InfrastructureError where two workers died on an episode.
        """
        for results in engine.map(self._job_batches(iter(chunks))):
            for result in results:
                done = self._take(result, advance)
                if done is not None:
                    yield done.chunk, [self._episode(done, n) for n in range(done.chunk.start, done.chunk.stop)]

    def _job_batches(self, chunks: Iterator[Chunk]) -> Iterator[JobBatch]:
        """Work for the engine whenever it asks; an empty batch to be asked again after a result.

        One question is always on its way to a policy, in a thread of its own, while workers simulate.
        """
        with ThreadPoolExecutor(1, "ask") as asker:
            asking: Future[tuple[_Question, _Answer]] | None = None
            while True:
                room = asking is None and not self._questions and self._open < _OPEN_CHUNKS
                if room and (chunk := next(chunks, None)) is not None:
                    self._begin(chunk)
                if asking is None and self._questions:
                    asking = asker.submit(self._ask, self._questions.popleft())
                if self._ready:
                    yield self._ready.popleft()
                elif asking is not None and (asking.done() or not self._flying):
                    self._give(*asking.result())
                    asking = None
                elif self._flying:
                    yield ()
                else:
                    return

    def _begin(self, chunk: Chunk) -> None:
        vary = self._vary[chunk.block]
        scenarios = {
            index: draw_scenario(self._seed, chunk.block, index, vary) for index in range(chunk.start, chunk.stop)
        }
        due = {index: first_step(scenario, "end-to-end") for index, scenario in scenarios.items()}
        self._open += 1
        self._next_step(_Open(chunk, scenarios, {index: [] for index in scenarios}, due))

    def _episode(self, done: _Open, index: int) -> Episode:
        """A finished episode of a chunk."""
        block, variation = done.chunk.block, done.scenarios[index].variation
        steps = tuple(done.steps[index])
        return Episode(block.task, block.round, block.split, index, self._seed, steps, variation)

    def _next_step(self, opened: _Open) -> None:
        """Queue the questions about the next step of a chunk, in order of its episodes."""
        due, opened.due = sorted(opened.due.items()), {}
        opened.flying = len(due)
        self._questions.extend((opened, due[n : n + BATCH]) for n in range(0, len(due), BATCH))

    def _ask(self, question: _Question) -> tuple[_Question, _Answer]:
        """Observations of the situations of a question, and the actions that its policy chooses; no state changes."""
        opened, due = question
        indices, situations = zip(*due, strict=True)
        step = situations[0].step
        behaviour = self._behaviour(opened.chunk.block, step)
        observations = [self._backend.observe(situation) for situation in situations]
        chosen = actions(
            ask(behaviour.process, self._backend, situations, observations),
            lambda position, fault: _no_action(behaviour, opened.chunk, indices[position], step, fault),
        )
        return question, (behaviour, observations, chosen)

    def _give(self, question: _Question, answer: _Answer) -> None:
        """Queue the jobs of a question that was answered."""
        opened, due = question
        behaviour, observations, chosen = answer
        jobs = []
        for (index, situation), observation, action in zip(due, observations, chosen, strict=True):
            key, self._number = self._number, self._number + 1
            self._flying[key] = _Asked(opened, index, situation, observation, action, behaviour)
            jobs.append(Job(key, situation, action))
        self._ready.extend(job_batches(jobs))

    def _take(self, result: JobResult, advance: Callable[[int], None]) -> _Open | None:
        """Record a result, and return its chunk where it was the last one of the chunk."""
        asked = self._flying.pop(result.key)
        opened, outcome = asked.open, result.outcome
        if isinstance(outcome, InfraError):
            raise _lost(asked, outcome)
        self.simulate_s += result.seconds
        played = asked.behaviour
        step = Step(asked.situation, asked.observation, Action(asked.action), outcome, played.name, played.digest)
        opened.steps[asked.index].append(step)
        following = next_step(opened.scenarios[asked.index], asked.situation, outcome)
        if following is None:
            advance(1)
        else:
            opened.due[asked.index] = following
        opened.flying -= 1
        if opened.flying:
            return None
        if opened.due:
            self._next_step(opened)
            return None
        self._open -= 1
        return opened


def _where(chunk: Chunk, index: int, step: int) -> tuple[str, dict[str, Any]]:
    facts = {"episode": index, "block": chunk.block.path, "step": step}
    return f"step {step} of episode {index} of {chunk.block.path}", facts


def _no_action(behaviour: _Behaviour, chunk: Chunk, index: int, step: int, fault: PolicyFault) -> PolicyFailureError:
    where, facts = _where(chunk, index, step)
    return PolicyFailureError(
        f"policy {behaviour.name} gave no action for {where}: {fault.reason}: {fault.detail}",
        hint="fix the policy; what it recorded so far then belongs to another policy and has to be played again",
        policy=behaviour.name,
        reason=str(fault.reason),
        **facts,
    )


def _lost(asked: _Asked, error: InfraError) -> InfrastructureError:
    where, facts = _where(asked.open.chunk, asked.index, asked.situation.step)
    return InfrastructureError(
        f"{where} was lost: its worker {error.reason} twice: {error.detail.strip().splitlines()[-1]}",
        hint="run the same command again: it resumes; --engine inline shows the whole error",
        reason=error.reason,
        **facts,
    )
