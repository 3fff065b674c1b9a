"""Uniform over the valid grid: the floor of every table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from baselines.observation_hash import observation_numbers
from evaluator.policy.contract import ObservationBatch

__all__ = ["RandomPolicy"]


class RandomPolicy:
    """One valid action, each equally likely, as a pure function of the observation.

    Parameters
    ----------
    checkpoint : Path or None
        Not used.
    device : str
        Not used.
    """

    def __init__(self, checkpoint: Path | None = None, device: str = "cpu") -> None:
        pass

    def act(self, observations: ObservationBatch) -> npt.NDArray[np.int64]:
        """Grid indices, int64 (N,)."""
        actions = np.empty(len(observations), np.int64)
        valid, allowed = None, np.empty(0, np.int64)
        for n, number in enumerate(observation_numbers(observations)):
            if valid is None or not np.array_equal(valid, observations.valid[n]):
                valid = observations.valid[n]
                allowed = np.flatnonzero(valid)
            actions[n] = allowed[number % len(allowed)]
        return actions
