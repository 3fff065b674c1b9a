"""Policies of submitters: one that scores every action, and ones that do not."""

from __future__ import annotations

import contextlib
import os
import socket
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


class RaisingPolicy(ScoringPolicy):
    """No maps, but words."""

    def maps(self, observations: Any) -> Any:
        raise ValueError("no idea")


class DyingPolicy(ScoringPolicy):
    """Ends instead."""

    def maps(self, observations: Any) -> Any:
        os._exit(5)


class CuriousPolicy(ScoringPolicy):
    """Its score is how much it found out."""

    def maps(self, observations: Any) -> Any:
        found = 0
        here = Path(__file__).parent
        for what in (
            lambda: (here / "runs" / "one" / "results.parquet").read_bytes(),
            lambda: socket.socket().close(),
            os.fork,
            lambda: Path("/proc", str(os.getppid()), "environ").read_bytes(),
        ):
            with contextlib.suppress(OSError):
                if what() == 0:
                    os._exit(0)  # the fork
                found += 1
        return np.full((len(observations), 64, 64, 16), found, np.float32)


class SilentPolicy:
    """No maps."""

    def __init__(self, checkpoint: Path | None, device: str) -> None: ...

    def act(self, observations: Any) -> Any:
        return np.zeros(len(observations), int)
