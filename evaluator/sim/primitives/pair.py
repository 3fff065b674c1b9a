"""Two arms that move as one: mirrored paths, and a squeeze held by feeling the contact force.

A fixed squeeze distance would let the force die away (position-controlled arms give way), so every control tick moves
both hands together or apart by a small correction until the weaker side presses with the wanted force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.sim.attempt import Attempt, Ended, finger_footprint, lowest_point
from evaluator.sim.kinematics import solve_path, within_limits
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect
from evaluator.sim.shapes import held_footprint
from rema_data.schema import Failure, Grip

Array = npt.NDArray[Any]

SIDES = (1.0, -1.0)
"""Left hand along +x of the pair frame, right hand along -x."""
HAND_TURNS = (math.pi / 2, 3 * math.pi / 2)
"""Yaw of the left and the right hand in the pair frame."""
_PROBE_M = 1e-3


def inner_extents(grips: tuple[Grip, ...]) -> tuple[float, float]:
    """How far each stick reaches from its hand towards the other one, metres: left, right."""
    left = min(rect.moved(0, 0, HAND_TURNS[0]).extent(0.0)[0] for rect in held_footprint(grips[0]))
    right = max(rect.moved(0, 0, HAND_TURNS[1]).extent(0.0)[1] for rect in held_footprint(grips[1]))
    return -left, right


def hand_footprints(grips: tuple[Grip, ...], distances: tuple[float, float], p: WorldParameters) -> list[list[Rect]]:
    """Footprints in the pair frame: fingers and stick of the left hand, then of the right hand."""
    result = []
    for grip, distance, side, turn in zip(grips, distances, SIDES, HAND_TURNS, strict=True):
        parts = (*finger_footprint(grip.opening_m, p), *held_footprint(grip))
        result.append([rect.moved(side * distance, 0.0, turn) for rect in parts])
    return result


@dataclass(slots=True)
class PairPath:
    """Joint targets of both arms along a path of the pair's origin, and how they change with the hands' distance.

    Attributes
    ----------
    positions : float64 (2, n + 1, 7)
    outwards : float64 (2, n + 1, 7)
        Change of the joints per metre that the hands move apart (each).
    velocities : float64 (2, n, 7)
    """

    positions: Array
    outwards: Array
    velocities: Array


def pair_path(
    attempt: Attempt, way: Array, theta: float, distances: tuple[Any, Any], heights: tuple[float, float]
) -> PairPath:
    """Joint paths of both arms; raises Ended(UNREACHABLE) outside the joint limits.

    Parameters
    ----------
    way : float64 (n + 1, 3)
        World positions of the pair's origin; z is added to ``heights``.
    theta : float
        Yaw of the pair.
    distances : float or float64 (n + 1,), for each hand
        From the pair's origin to the tool centre point.
    heights : (float, float)
        Of the tool centre points above the way.
    """
    p = attempt.parameters
    positions, outwards = [], []
    for hand, side, turn, distance, height in zip(
        attempt.hands, SIDES, HAND_TURNS, distances, heights, strict=True
    ):
        yaw = np.full(len(way), theta + turn)
        both = [
            solve_path(
                hand.arm.base,
                way[:, 0] + side * (distance + extra) * math.cos(theta),
                way[:, 1] + side * (distance + extra) * math.sin(theta),
                way[:, 2] + height,
                yaw,
                False,
                p,
            )
            for extra in (0.0, _PROBE_M)
        ]
        if not within_limits(both[0], p).all():
            raise Ended(Failure.UNREACHABLE)
        positions.append(both[0])
        outwards.append((both[1] - both[0]) / _PROBE_M)
    tick = p.time_step_s * p.control_every
    stacked = np.stack(positions)
    return PairPath(stacked, np.stack(outwards), np.diff(stacked, axis=1) / tick)


def command(attempt: Attempt, path: PairPath, row: int, inwards_m: float, moving: bool = True) -> None:
    """Set both arms' targets to a row of a path, each hand moved ``inwards_m`` towards the other."""
    for side, hand in enumerate(attempt.hands):
        target = path.positions[side, row] - inwards_m * path.outwards[side, row]
        still = not moving or row == 0
        hand.arm.follow(target, np.zeros(7) if still else path.velocities[side, row - 1])


@dataclass(slots=True)
class Squeeze:
    """The force loop: how far the hands have been moved together so far.

    Attributes
    ----------
    body : int
        What is squeezed.
    inwards_m : float
    """

    body: int
    inwards_m: float = 0.0

    def forces(self, attempt: Attempt) -> tuple[float, float]:
        """Normal force of the left and of the right stick on the body in the last step, N."""
        world = attempt.world
        left, right = (hand.tool for hand in attempt.hands)
        assert left is not None and right is not None
        return world.force(left, self.body), world.force(right, self.body)

    def correct(self, attempt: Attempt) -> float:
        """One control tick of the integrator; returns the weaker side's force (N)."""
        p = attempt.parameters
        weaker = min(self.forces(attempt))
        limit = p.pair_max_correction_m
        self.inwards_m += max(-limit, min(limit, p.pair_gain_m_per_n * (p.pair_squeeze_n - weaker)))
        return weaker

    def hold(self, attempt: Attempt, path: PairPath, row: int, steps: int) -> float:
        """Stand still and squeeze for a number of steps; returns the weaker side's last force (N)."""
        weaker = 0.0
        for _ in range(steps // attempt.parameters.control_every):
            weaker = self.correct(attempt)
            command(attempt, path, row, self.inwards_m, moving=False)
            attempt.step(attempt.parameters.control_every)
        return weaker

    def carry(self, attempt: Attempt, path: PairPath, lost: Failure, after_tick: Any = None) -> None:
        """Follow a path while squeezing; ends with ``lost`` once neither... or only one stick feels the body."""
        misses = 0
        for row in range(1, path.positions.shape[1]):
            weaker = self.correct(attempt)
            command(attempt, path, row, self.inwards_m)
            attempt.step(attempt.parameters.control_every)
            misses = misses + 1 if weaker <= 0.0 else 0
            if misses >= 24:
                raise Ended(lost)
            if after_tick is not None:
                after_tick()


def pair_heights(grips: tuple[Grip, ...], clearance_m: float) -> tuple[float, float]:
    """Heights of the two tool centre points that put each hand's lowest point ``clearance_m`` above the way's z."""
    left, right = (clearance_m - lowest_point(grip) for grip in grips)
    return left, right


def take_sticks(
    attempt: Attempt,
    pose: tuple[float, float, float],
    distances: tuple[float, float],
    heights: tuple[float, float],
) -> None:
    """Put the sticks into the hands, at rest."""
    x, y, theta = pose
    for hand, side, turn, distance, height in zip(
        attempt.hands, SIDES, HAND_TURNS, distances, heights, strict=True
    ):
        grip = hand.grip
        assert grip is not None
        hx, hy, yaw = x + side * distance * math.cos(theta), y + side * distance * math.sin(theta), theta + turn
        c, s = math.cos(yaw), math.sin(yaw)
        hand.tool = attempt.world.place(
            grip.spec,
            hx + c * grip.x_m - s * grip.y_m,
            hy + s * grip.x_m + c * grip.y_m,
            height + grip.z_m,
            yaw + grip.yaw_rad,
        )
        hand.arm.close_fingers()
