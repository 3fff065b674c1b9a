"""What runs on the machines of a Ray cluster: one actor, which is the parent of one supervised simulation worker.

Ray is not imported here: the engine turns the class into an actor.
"""

from __future__ import annotations

from typing import Any

from evaluator.engines.base import BatchResult, JobBatch
from evaluator.engines.child import call_in_child
from evaluator.engines.process import ProcessEngine

__all__ = ["RayWorker"]


class RayWorker:
    """Runs batches one after the other, each in a simulation process that may crash, hang or leak.

    Parameters
    ----------
    factory : str
        ``module:attribute`` of the simulator's factory.
    episode_limit_s : float
        As in ``ProcessEngine``.
    """

    def __init__(self, factory: str, episode_limit_s: float) -> None:
        # The simulator is in a process of its own, so that what it does to itself is no loss of the actor.
        self._engine = ProcessEngine(factory, 1, episode_limit_s=episode_limit_s)

    def begin(self, same: str | None) -> Any:
        """Value of the call that ``same`` names, on this machine: the actor is there once this has come back."""
        return None if same is None else call_in_child(same)

    def run(self, batch: JobBatch) -> BatchResult:
        """Results of all jobs of a batch."""
        return tuple(result for part in self._engine.map((batch,)) for result in part)
