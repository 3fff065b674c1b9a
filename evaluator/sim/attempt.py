"""One attempt: the hands and bodies that take part, the watch over forbidden contacts, and the evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING

from evaluator.sim.motion import JointPath
from evaluator.sim.parameters import WorldParameters
from rema_data.schema import Evidence, Failure, Grip, Pinch, Situation

if TYPE_CHECKING:  # the maps of a kind of step are painted without PyBullet
    from evaluator.sim.world import Arm, World

POLL_EVERY = 4
"""Simulation steps between two looks at the target."""
CLEAR_M = 0.002
"""Footprints farther apart than this can't touch during a straight descent."""
CLEAR_TOOL_M = 0.005
"""As ``CLEAR_M``, for a held tool, which may shift a little in the hand before it touches anything."""


class AttemptFailed(Exception):
    """Ends an attempt with its failure label; caught by the simulator, never seen by a caller."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure)
        self.failure = failure


@dataclass(slots=True)
class Hand:
    """An acting arm, and the tool it holds (its record and its body) if any."""

    arm: Arm
    grip: Grip | None = None
    tool: int | None = None


@dataclass(slots=True)
class Attempt:
    """A world in which one step is being carried out."""

    world: World
    situation: Situation
    hands: list[Hand]
    target: int  # body of the object of this step
    allowed: tuple[int, ...]  # bodies that may touch the target
    forbidden: tuple[int, ...] = ()  # bodies that must not touch the target
    # the fields of ``Evidence``, as measured so far: every few simulation steps, and a frozen record is slow to replace
    evidence: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(**Evidence().evidence()))
    loose: tuple[int, ...] = ()  # further loose objects, which stay on the table
    posts: tuple[int, ...] = ()  # bodies that nothing may touch

    @property
    def parameters(self) -> WorldParameters:
        """Constants of the world."""
        return self.world.parameters

    @property
    def tick_s(self) -> float:
        """Time between two joint targets."""
        return self.parameters.time_step_s * self.parameters.control_every

    def note_lift(self, rest_z_m: float) -> float:
        """Measure how far the target's centre of mass is above its height at rest now, m."""
        height: float = self.world.pose(self.target)[2] - rest_z_m
        self.evidence.lift_m = max(self.evidence.lift_m, height)
        return height

    def too_much(self, force_n: float) -> bool:
        """Measure the force of a descent, and say whether it calls for the protective stop."""
        self.evidence.peak_force_n = max(self.evidence.peak_force_n, force_n)
        return force_n > self.parameters.stop_force_n

    def step(self, count: int = 1) -> None:
        """Advance, watching for forbidden contacts after every simulation step."""
        world = self.world
        if not self.forbidden and not self.posts:
            world.step(count)
            return
        for _ in range(count):
            world.step()
            self.check_forbidden()

    def check_forbidden(self) -> None:
        """End the attempt if a body that must not touch the target touches it, or anything that moves a post."""
        touching = self.world.touching
        if any(touching(body, self.target) for body in self.forbidden) or (
            self.posts and any(touching(body, post) for post in self.posts for body in (*self.acting, self.target))
        ):
            self.evidence.illegal_steps += 1
            raise AttemptFailed(Failure.ILLEGAL_CONTACT)

    @property
    def acting(self) -> tuple[int, ...]:
        """Bodies of the hands, and of what they hold."""
        tools = (hand.tool for hand in self.hands if hand.tool is not None)
        return tuple(dict.fromkeys((*(hand.arm.body for hand in self.hands), *tools, *self.allowed)))

    def check_alone(self) -> None:
        """End the attempt if something else was lifted with the target."""
        if any(self.world.pose(body)[2] > self.parameters.slip_lift_m + height for body, height in self._resting()):
            raise AttemptFailed(Failure.ILLEGAL_CONTACT)

    def _resting(self) -> Iterator[tuple[int, float]]:
        """The further loose objects, each with the height of its centre of mass on the table."""
        if self.loose and self.situation.variation is not None:
            for body, other in zip(self.loose, self.situation.variation.others, strict=True):
                yield body, other.spec.height_m / 2

    def touched(self) -> bool:
        """Whether an allowed body presses on the target now; counted as evidence."""
        touching = any(self.world.touching(body, self.target) for body in self.allowed)
        if touching:
            self.evidence.contact_steps += 1
        return touching

    def descend(self, paths: Sequence[JointPath]) -> None:
        """Move down, and end the attempt if hand or tool lands on the target (protective stop)."""
        bodies = {hand.arm.body for hand in self.hands} | {hand.tool for hand in self.hands if hand.tool is not None}
        bodies |= set(self.allowed)
        struck = (self.target, *self.loose)
        for targets in zip(*(path.targets() for path in paths), strict=True):
            for hand, target in zip(self.hands, targets, strict=True):
                hand.arm.follow(*target)
            for _ in range(self.parameters.control_every):
                self.world.step()
                if self.too_much(sum(self.world.force(body, on) for on in struck for body in bodies)):
                    self.evidence.contact_steps += 1
                    raise AttemptFailed(Failure.BLOCKED)
                self.check_forbidden()

    def grip_in_hand(self, hand: Hand) -> tuple[float, float, float, float]:
        """Pose of the held tool in the hand frame: x, y, z (m), yaw (rad)."""
        assert hand.tool is not None
        return relative(self.world.pose(hand.tool), hand.arm.hand_pose())

    def tools_held(self) -> bool:
        """Whether every tool is still where it was in its hand, within the tolerance of the protocol."""
        return all(
            hand.tool is None or hand.grip is None or self.unmoved(self.grip_in_hand(hand), hand.grip)
            for hand in self.hands
        )

    def unmoved(self, pose: tuple[float, float, float, float], held: Grip | Pinch) -> bool:
        """Whether a pose (x, y, z, yaw) is still that at which something was held, within the same tolerance."""
        slip = math.dist(pose[:3], (held.x_m, held.y_m, held.z_m))
        turned = abs(wrap(pose[3] - held.yaw_rad))
        return not (slip > self.parameters.max_tool_slip_m or turned > self.parameters.max_tool_turn_rad)


def relative(
    pose: tuple[float, float, float, float], frame: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """A pose (x, y, z, yaw) of the world frame, seen from another one."""
    c, s = math.cos(frame[3]), math.sin(frame[3])
    dx, dy = pose[0] - frame[0], pose[1] - frame[1]
    return c * dx + s * dy, c * dy - s * dx, pose[2] - frame[2], wrap(pose[3] - frame[3])


def wrap(angle: float) -> float:
    """Angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
