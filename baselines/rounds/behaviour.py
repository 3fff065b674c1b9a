"""Behaviour policies: who plays which step of which block, each in a process of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from baselines.rounds.plan import BlockPlan, PolicyUse
from evaluator.rollout.backend import Backend, PolicyProcess
from rema_data.store.block import BlockKey

__all__ = ["Behaviour", "BehaviourPolicies"]


@dataclass(frozen=True, slots=True)
class Behaviour:
    """A policy that runs.

    Attributes
    ----------
    name, digest : str
        Recorded with every step that it plays.
    process : PolicyProcess
    """

    name: str
    digest: str
    process: PolicyProcess


class BehaviourPolicies:
    """The policies of some blocks, alive from ``start`` to ``close``.

    Parameters
    ----------
    blocks : sequence of BlockPlan
    backend : Backend
    logs : Path
        Folder in which their output is kept.

    Attributes
    ----------
    digests : dict of PolicyUse to str

    Raises
    ------
    MissingFileError
        Code or weights of one are not there.
    """

    def __init__(self, blocks: Sequence[BlockPlan], backend: Backend, logs: Path) -> None:
        self._uses = {block.key: block.policies for block in blocks}
        self._backend, self._logs = backend, logs
        every = dict.fromkeys(use for block in blocks for use in block.policies)
        self.digests = {use: backend.policy_digest(use.spec, use.checkpoint) for use in every}
        self._running: dict[PolicyUse, Behaviour] = {}
        self._stack = ExitStack()

    def start(self, blocks: Iterable[BlockKey]) -> None:
        """Start every policy that some blocks need: one that cannot be loaded is to be known at once.

        Raises
        ------
        SubmissionError
            A policy cannot be loaded.
        """
        for use in dict.fromkeys(use for block in blocks for use in self._uses[block]):
            log = self._logs / f"policy-{use.spec.name}-{self.digests[use][:8]}.log"
            process = self._backend.open_policy(use.spec, use.checkpoint, use.device, log, None)
            self._running[use] = Behaviour(use.spec.name, self.digests[use], self._stack.enter_context(process))

    def of(self, block: BlockKey, step: int) -> Behaviour:
        """Who plays a step of a block."""
        return self._running[self._uses[block][step]]

    def close(self) -> None:
        """End them."""
        self._running.clear()
        self._stack.close()
