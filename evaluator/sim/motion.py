"""Trajectories: a trapezoidal speed profile along straight lines, solved once for all joint targets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.sim.kinematics import Base, solve_path, within_limits
from evaluator.sim.parameters import WorldParameters

Array = npt.NDArray[Any]


@lru_cache(maxsize=64)
def profile(distance_m: float, speed_m_s: float, tick_s: float, ramp_share: float) -> Array:
    """Share of the way covered at every tick, float64 (n + 1,), read-only.

    Speed rises and falls linearly, each over ``ramp_share`` of the duration.
    """
    duration = abs(distance_m) / (speed_m_s * (1 - ramp_share))
    ticks = max(1, math.ceil(duration / tick_s))
    t = np.arange(ticks + 1) / ticks
    top = 1 / (1 - ramp_share)
    rising = top * t**2 / (2 * ramp_share)
    cruising = top * (t - ramp_share / 2)
    falling = 1 - top * (1 - t) ** 2 / (2 * ramp_share)
    shares: Array = np.where(t < ramp_share, rising, np.where(t <= 1 - ramp_share, cruising, falling))
    shares.setflags(write=False)
    return shares


@dataclass(frozen=True, slots=True)
class JointPath:
    """Joint targets of one arm at every control tick."""

    positions: Array  # float64 (n + 1, 7), radians; the first row is where the path starts
    velocities: Array  # float64 (n, 7), radians per second on the way to the next row

    def targets(self) -> Iterator[tuple[list[float], list[float]]]:
        """Positions and velocities of every control tick after the start."""
        return zip(self.positions[1:].tolist(), self.velocities.tolist(), strict=True)

    @property
    def reachable(self) -> bool:
        """Whether the whole path is within the joint limits."""
        return bool(within_limits(self.positions).all())


def line(
    base: Base,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    yaw_rad: float,
    shares: Array,
    tick_s: float,
    symmetric: bool,
    parameters: WorldParameters,
) -> JointPath:
    """Joint path of a straight line of the tool centre point at a constant yaw.

    ``start`` and ``end`` are world (x, y, z), metres; ``shares`` float64 (n + 1,); ``symmetric`` as in ``solve_path``.
    """
    way = np.asarray(start)[:, None] + (np.asarray(end) - np.asarray(start))[:, None] * shares
    positions = solve_path(base, way[0], way[1], way[2], yaw_rad, symmetric, parameters)
    return JointPath(positions, np.diff(positions, axis=0) / tick_s)
