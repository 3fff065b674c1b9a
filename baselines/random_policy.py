"""Uniform over the valid grid: the floor of every table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from baselines.observation_hash import observation_number
from evaluator.policy.interface import ObservationBatch

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
        for n in range(len(observations)):
            allowed = np.flatnonzero(observations.valid[n])
            actions[n] = allowed[observation_number(observations, n) % len(allowed)]
        return actions
