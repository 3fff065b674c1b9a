"""Two arms that move as one: mirrored paths, and a squeeze held by feeling the contact force.

With a fixed squeeze distance the force would die away, since position-controlled arms give way. So every control tick
moves both hands together or apart by a small correction, towards a target force of the weaker side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evaluator.sim.attempt import Attempt, AttemptFailed
from evaluator.sim.footprints import HAND_TURNS, SIDES, inner_extents
from evaluator.sim.kinds.base import Kind
from evaluator.sim.kinematics import solve_path, within_limits
from evaluator.sim.motion import JointPath, profile
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.staging import Pose
from rema_data.schema import Failure

__all__ = ["PairPath", "Squeeze", "TwoArms", "command", "pair_frame", "pair_path", "sticks_of"]

Array = npt.NDArray[Any]

_PROBE_M = 1e-3


@dataclass(slots=True)
class PairPath:
    """Joint targets of both arms along a path of the pair's origin, and how they change with the hands' distance."""

    positions: Array  # float64 (2, n + 1, 7)
    outwards: Array  # float64 (2, n + 1, 7): change per metre that each hand moves outwards
    velocities: Array  # float64 (2, n, 7)

    def of_each_hand(self) -> list[JointPath]:
        """The path of every hand by itself."""
        return [JointPath(self.positions[side], self.velocities[side]) for side in range(2)]


def pair_path(
    attempt: Attempt, way: Array, theta: float, distances: tuple[Any, ...], heights: tuple[float, ...]
) -> PairPath:
    """Joint paths of both arms; raises AttemptFailed(UNREACHABLE) outside the joint limits.

    ``way``, float64 (n + 1, 3), has world positions of the pair's origin, ``theta`` is its yaw. For each hand,
    ``distances`` (float or float64 (n + 1,)) lead from the origin to the tool centre point, ``heights`` raise it.
    """
    p = attempt.parameters
    positions, outwards = [], []
    for hand, side, turn, distance, height in zip(attempt.hands, SIDES, HAND_TURNS, distances, heights, strict=True):
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
            raise AttemptFailed(Failure.UNREACHABLE)
        positions.append(both[0])
        outwards.append((both[1] - both[0]) / _PROBE_M)
    stacked = np.stack(positions)
    return PairPath(stacked, np.stack(outwards), np.diff(stacked, axis=1) / attempt.tick_s)


def command(attempt: Attempt, path: PairPath, row: int, inwards_m: float, moving: bool = True) -> None:
    """Set both arms' targets to a row of a path, each hand moved ``inwards_m`` towards the other."""
    for side, hand in enumerate(attempt.hands):
        target = path.positions[side, row] - inwards_m * path.outwards[side, row]
        still = not moving or row == 0
        hand.arm.follow(target.tolist(), [0.0] * 7 if still else path.velocities[side, row - 1].tolist())


@dataclass(slots=True)
class Squeeze:
    """The force loop: the body that is squeezed, and how far the hands have been moved together so far."""

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

    def carry(
        self, attempt: Attempt, path: PairPath, lost: Failure, after_tick: Callable[[], object] | None = None
    ) -> None:
        """Follow a path while squeezing; ends the attempt with ``lost`` once a stick has lost the body for good."""
        p = attempt.parameters
        misses = 0
        for row in range(1, path.positions.shape[1]):
            weaker = self.correct(attempt)
            command(attempt, path, row, self.inwards_m)
            attempt.step(p.control_every)
            misses = misses + 1 if weaker <= 0.0 else 0
            if misses * p.control_every == p.pair_lost_steps:
                raise AttemptFailed(lost)
            if after_tick is not None:
                after_tick()


class TwoArms(Kind):
    """A step of two hands that act as one, each with a stick along the pair's axis, across the jaws.

    The pair's frame has its origin midway between the tips of the sticks. The right hand is the left one turned by half
    a turn about it.
    """

    turns = HAND_TURNS

    def reach_distances(self, p: WorldParameters) -> tuple[float, ...]:
        """Smallest and largest distance from the pair's origin: sticks held within a quarter of their middle."""
        half_short, half_long = p.stick_length_min_m / 2, p.stick_length_max_m / 2
        return 0.75 * half_short, 1.25 * half_long + p.pair_open_m

    def lower(self, attempt: Attempt, pose: Pose, start_m: float, path: PairPath) -> PairPath | None:
        """Put the pair with its sticks ``start_m`` above the first row of ``path``, at rest; returns the way down."""
        p, situation = attempt.parameters, attempt.situation
        down = None
        if start_m > 0.0:
            shares = profile(start_m, p.descend_speed_m_s, attempt.tick_s, p.ramp_share)
            x, y = np.full_like(shares, pose[0]), np.full_like(shares, pose[1])
            fall = np.stack([x, y, start_m * (1 - shares)], axis=1)
            distances, heights = self.distances(situation, False, p), self.heights(situation, p)
            down = pair_path(attempt, fall, pose[2], distances, heights)
            # the same turn of joint 7 as the path that follows
            down.positions[:, :, 6] += (path.positions[:, 0, 6] - down.positions[:, -1, 6])[:, None]
        first = (path if down is None else down).positions[:, 0]
        for joints, hand, grip in zip(first, attempt.hands, situation.grips, strict=True):
            hand.arm.reset(joints, grip.opening_m)
        sticks = self.held(situation, self.hands(situation, pose, start_m, p=p), pose)
        for hand, stick in zip(attempt.hands, sticks, strict=False):
            hand.tool = attempt.world.put(stick)
            hand.arm.close_fingers()
        return down


def sticks_of(attempt: Attempt) -> tuple[int, ...]:
    """Bodies of the two sticks."""
    return tuple(hand.tool for hand in attempt.hands if hand.tool is not None)


def pair_frame(attempt: Attempt, theta: float) -> tuple[float, float, tuple[float, float, float, float]]:
    """Distances of the hands from the pair's origin, and the pair frame (x, y, z of the lower hand, yaw)."""
    left, right = (hand.arm.hand_pose() for hand in attempt.hands)
    extents = inner_extents(attempt.situation.grips)
    c, s = math.cos(theta), math.sin(theta)
    along = (left[0] - right[0]) * c + (left[1] - right[1]) * s
    half = (along - extents[0] - extents[1]) / 2  # from the origin to each tip
    left_m, right_m = half + extents[0], half + extents[1]
    x, y = left[0] - left_m * c, left[1] - left_m * s
    return left_m, right_m, (x, y, min(left[2], right[2]), theta)
