"""A learned policy whose hand arrives up to a pixel beside where it is sent: what noise in acting would cost.

``rema evaluate benchmarks/policies/displaced.py --checkpoint releases/checkpoints/rema-v0/round-1 --task grasp``
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from baselines.observation_hash import observation_numbers
from baselines.tae_policy import TaePolicy
from evaluator.policy.contract import ObservationBatch
from rema_data import grid

__all__ = ["Policy"]


class Policy(TaePolicy):
    """``tae``, answered by one of the nine pixels around its action, each equally likely, at the same angle."""

    def act(self, observations: ObservationBatch) -> npt.NDArray[np.int64]:
        """Grid indices, int64 (N,); the action itself where the pixel beside it may not be acted on."""
        meant = super().act(observations)
        i, j, k = grid.decode(meant)
        steps = np.array([divmod(number % 9, 3) for number in observation_numbers(observations)]) - 1
        i, j = (np.clip(place + step, 0, grid.SCENE_PIXELS - 1) for place, step in zip((i, j), steps.T, strict=True))
        allowed = observations.valid[np.arange(len(meant)), i, j, k]
        displaced: npt.NDArray[np.int64] = np.where(allowed, grid.encode(i, j, k), meant)
        return displaced
