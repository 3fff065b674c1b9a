"""A number drawn from an observation itself: random to the eye, the same in any batch, order and process."""

from __future__ import annotations

import hashlib

from evaluator.policy.interface import ObservationBatch

__all__ = ["observation_number"]


def observation_number(observations: ObservationBatch, n: int) -> int:
    """sha256 of observation ``n`` and of its step, as an integer below 2**256.

    Uniform choices are taken from it by remainder; the bias is below 2**-240.
    """
    text = f"{observations.task}/{observations.step}/"
    digest = hashlib.sha256(text.encode())
    digest.update(observations.scene[n].astype("<f4").tobytes())
    digest.update(observations.end_effector[n].astype("<f4").tobytes())
    return int.from_bytes(digest.digest(), "big")
