"""One attempt: the hands and bodies that take part, the watch over forbidden contacts, and the evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from evaluator.sim.motion import JointPath
from evaluator.sim.parameters import WorldParameters
from evaluator.sim.world import Arm, World
from rema_data.schema import Failure, Grip, Situation


class Ended(Exception):
    """Ends an attempt with its failure label; caught by the simulator, never seen by a caller."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure)
        self.failure = failure


@dataclass(slots=True)
class Evidence:
    """What was observed during an attempt; becomes part of the StepOutcome."""

    displacement_m: float = 0.0
    lift_m: float = 0.0
    peak_force_n: float = 0.0
    contact_steps: int = 0
    illegal_steps: int = 0


@dataclass(slots=True)
class Hand:
    """An acting arm, and the tool it holds (its record and its body) if any."""

    arm: Arm
    grip: Grip | None = None
    tool: int | None = None


@dataclass(slots=True)
class Attempt:
    """A world in which one step is being carried out.

    Attributes
    ----------
    world : World
    situation : Situation
    hands : list of Hand
    target : int
        Body of the object of this step.
    allowed, forbidden : tuple of int
        Bodies that may, and that must not, touch the target.
    """

    world: World
    situation: Situation
    hands: list[Hand]
    target: int
    allowed: tuple[int, ...]
    forbidden: tuple[int, ...] = ()
    evidence: Evidence = field(default_factory=Evidence)

    @property
    def parameters(self) -> WorldParameters:
        """Constants of the world."""
        return self.world.parameters

    def step(self, count: int = 1) -> None:
        """Advance, watching for forbidden contacts after every simulation step."""
        world = self.world
        if not self.forbidden:
            world.step(count)
            return
        for _ in range(count):
            world.step()
            for body in self.forbidden:
                if world.touching(body, self.target):
                    self.evidence.illegal_steps += 1
                    raise Ended(Failure.ILLEGAL_CONTACT)

    def touched(self) -> bool:
        """Whether an allowed body presses on the target now; counted as evidence."""
        touching = any(self.world.touching(body, self.target) for body in self.allowed)
        self.evidence.contact_steps += touching
        return touching

    def follow(self, paths: Sequence[JointPath]) -> None:
        """Move every hand along its path, one row a control tick, in step with each other."""
        every = self.parameters.control_every
        for tick in range(len(paths[0].velocities)):
            self.command(paths, tick)
            self.step(every)

    def command(self, paths: Sequence[JointPath], tick: int) -> None:
        """Set every hand's joint targets for one control tick."""
        for hand, path in zip(self.hands, paths, strict=True):
            hand.arm.follow(path.positions[tick + 1], path.velocities[tick])

    def descend(self, paths: Sequence[JointPath]) -> None:
        """Move down, and end the attempt if hand or tool lands on the target (protective stop)."""
        bodies = {hand.arm.body for hand in self.hands} | {hand.tool for hand in self.hands if hand.tool is not None}
        bodies |= set(self.allowed)
        for tick in range(len(paths[0].velocities)):
            self.command(paths, tick)
            for _ in range(self.parameters.control_every):
                self.world.step()
                force = sum(self.world.force(body, self.target) for body in bodies)
                self.evidence.peak_force_n = max(self.evidence.peak_force_n, force)
                if force > self.parameters.stop_force_n:
                    self.evidence.contact_steps += 1
                    raise Ended(Failure.BLOCKED)
                if any(self.world.touching(body, self.target) for body in self.forbidden):
                    self.evidence.illegal_steps += 1
                    raise Ended(Failure.ILLEGAL_CONTACT)

    def grip_in_hand(self, hand: Hand) -> tuple[float, float, float, float]:
        """Pose of the held tool in the hand frame: x, y, z (m), yaw (rad)."""
        assert hand.tool is not None
        return relative(self.world.pose(hand.tool), hand.arm.hand_pose())

    def tools_held(self) -> bool:
        """Whether every tool is still where it was in its hand, within the tolerance of the protocol."""
        p = self.parameters
        for hand in self.hands:
            if hand.tool is None or hand.grip is None:
                continue
            x, y, z, yaw = self.grip_in_hand(hand)
            slip = math.dist((x, y, z), (hand.grip.x_m, hand.grip.y_m, hand.grip.z_m))
            if slip > p.max_tool_slip_m or abs(wrap(yaw - hand.grip.yaw_rad)) > p.max_tool_turn_rad:
                return False
        return True


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
