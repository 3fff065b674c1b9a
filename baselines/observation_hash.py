"""A number drawn from an observation itself: random to the eye, the same in any batch, order and process."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt

from evaluator.policy.contract import ObservationBatch

__all__ = ["observation_numbers"]


def observation_numbers(observations: ObservationBatch) -> list[int]:
    """sha256 of every observation and of its step, as integers below 2**256.

    Uniform choices are taken from them by remainder; the bias is below 2**-240.
    """
    step = f"{observations.task}/{observations.step}/".encode()
    numbers = []
    hand, hand_digest = None, b""
    for scene, end_effector in zip(observations.scene, observations.end_effector, strict=True):
        # Bare hands all look the same, and their map is most of the bytes.
        if hand is None or not np.array_equal(hand, end_effector):
            hand, hand_digest = end_effector, hashlib.sha256(_bytes(end_effector)).digest()
        digest = hashlib.sha256(step + hand_digest)
        digest.update(_bytes(scene))
        numbers.append(int.from_bytes(digest.digest(), "big"))
    return numbers


def _bytes(heights: npt.NDArray[np.float32]) -> memoryview:
    """The array in canonical layout: little endian, row by row."""
    return np.ascontiguousarray(heights, "<f4").data
