"""Policies of submitters: one that scores every action, and ones that do not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


class ScoringPolicy:
    """Its scores rise with the column and fall with the angle."""

    def __init__(self, checkpoint: Path | None, device: str) -> None:
        assert checkpoint is None and device == "cpu"

    def act(self, observations: Any) -> Any:
        return self.maps(observations).reshape(len(observations), -1).argmax(1)

    def maps(self, observations: Any) -> Any:
        columns = np.arange(64, dtype=np.float32)[:, None] / 64
        angles = 1 - np.arange(16, dtype=np.float32) / 16
        return np.broadcast_to(columns * angles, (len(observations), 64, 64, 16))


class OddsPolicy(ScoringPolicy):
    """Scores that are no shares."""

    def maps(self, observations: Any) -> Any:
        return 10 * super().maps(observations)


class FlatPolicy(ScoringPolicy):
    """Maps of another shape."""

    def maps(self, observations: Any) -> Any:
        return np.zeros((len(observations), 64, 64), np.float32)


class SilentPolicy:
    """No maps."""

    def __init__(self, checkpoint: Path | None, device: str) -> None: ...

    def act(self, observations: Any) -> Any:
        return np.zeros(len(observations), int)
