"""What every kind of step answers.

A kind is a stateless object; only ``carry_out`` needs PyBullet. One hand acts at the action's place, unless a kind says
otherwise (``pair.TwoArms``). ``primitives`` has what all grasps, and all pushes, share.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from evaluator.sim.attempt import CLEAR_M, Attempt
from evaluator.sim.footprints import SIDES, clear_of_target, hand_footprint
from evaluator.sim.motion import JointPath, line, profile
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.planar import Rect
from evaluator.sim.staging import ARMS, HandPose, Part, Pose, Thing, turned
from evaluator.sim.varied import standing
from rema_data.schema import Grip, Pinch, Placement, Situation, StepKind

__all__ = ["TOOL_HEIGHTS_M", "Kind"]

Flags = npt.NDArray[np.bool_]

TOOL_HEIGHTS_M = (0.0, 0.03)
"""Heights of the tool centre point between which a held tool's lowest point is at its clearance."""


class Kind(ABC):
    """One kind of step, ``step`` in the schema."""

    step: ClassVar[StepKind]
    acting: ClassVar[str]  # in words, what acts ("a tool")
    touching: ClassVar[str]  # in words, the only thing that may touch the target ("the held tool")
    role: ClassVar[str | None] = None  # of the thing that may touch the target (``Thing``); None for the fingers
    measure: ClassVar[str]  # the field of ``Evidence`` that success is measured by
    closes: ClassVar[bool] = False  # the end effector closes, so its two states differ
    symmetric: ClassVar[bool] = False  # half a turn of the hand makes no difference
    tools_touch: ClassVar[bool] = True  # held tools may touch the target
    sides: ClassVar[tuple[float, ...]] = SIDES  # direction of each hand from the action's place along its axis
    turns: ClassVar[tuple[float, ...]] = (0.0, 0.0)  # yaw of each hand against the action's

    @cached_property
    def two_arms(self) -> bool:
        """Whether both arms act as one."""
        return self.step.embodiment.two_arms

    @cached_property
    def bare(self) -> bool:
        """Whether the fingers may touch the target; otherwise they must not, and something is held."""
        return self.step.embodiment.bare

    # Reach: an arm must get to every combination of these

    def reach_distances(self, p: WorldParameters) -> tuple[float, ...]:
        """Distances of a hand from the action's place, m."""
        return (0.0,)

    @abstractmethod
    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        """Heights of the tool centre point, m."""

    @abstractmethod
    def reach_shifts(self, p: WorldParameters) -> tuple[float, ...]:
        """Points of the hand's way along +x, m; the last one is its end."""

    # Staging: where hands and held things stand

    def distances(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        """Distance of each hand from the action's place, m, in the start or the end (closed) state."""
        return (0.0,)

    def heights(self, situation: Situation, p: WorldParameters) -> tuple[float, ...]:
        """Height of each tool centre point above the height of the whole, m."""
        return (0.0,)

    def openings(self, situation: Situation, closed: bool, p: WorldParameters) -> tuple[float, ...]:
        """Gap between the fingers of each hand, m: as wide as its tool."""
        return tuple(grip.opening_m for grip in situation.grips)

    def grips(self, situation: Situation) -> tuple[Grip, ...]:
        """The tools that take part."""
        return () if self.bare else situation.grips

    def start_height(self, situation: Situation, clearance_m: float) -> float:
        """Height of the whole that keeps what is held ``clearance_m`` above all that stands on the table."""
        return max(placement.spec.height_m for placement in standing(situation)) + clearance_m

    def hands(
        self,
        situation: Situation,
        pose: Pose,
        height_m: float,
        arm: str = "left",
        closed: bool = False,
        p: WorldParameters = WORLD,
    ) -> list[HandPose]:
        """Poses of the hands that act, ``arm`` where only one does, in the start or the end (closed) state.

        ``pose`` and ``height_m`` are those of the tool centre point. For a pair they are those of its origin, above
        which ``heights`` raises the hands.
        """
        x, y, yaw = pose
        c, s = math.cos(yaw), math.sin(yaw)
        hands = zip(
            ARMS if self.two_arms else (arm,),
            self.sides,
            self.turns,
            self.distances(situation, closed, p),
            self.heights(situation, p),
            self.openings(situation, closed, p),
            strict=False,
        )
        return [
            HandPose(name, x + side * far * c, y + side * far * s, height_m + height, yaw + turn, opening)
            for name, side, turn, far, height, opening in hands
        ]

    def held(self, situation: Situation, hands: list[HandPose], pose: Pose) -> list[Thing]:
        """What hands at these poses hold, in the order in which it is put there: tools, then a pinched object."""
        things = []
        for hand, grip in zip(hands, self.grips(situation), strict=False):
            x, y = turned((hand.x_m, hand.y_m, hand.yaw_rad), grip.x_m, grip.y_m)
            things.append(Thing("tool", grip.spec, x, y, hand.z_m + grip.z_m, hand.yaw_rad + grip.yaw_rad))
        return things

    # Footprints and maps, in the frame of the action

    def footprints(self, situation: Situation, closed: bool, p: WorldParameters) -> list[list[Rect]]:
        """Fingers and tool of every hand: two fingers, then the boxes of its tool."""
        distances, openings = self.distances(situation, closed, p), self.openings(situation, closed, p)
        grips = self.grips(situation) or (None,)
        if not self.two_arms:  # the hand's frame is that of the action
            return [list(hand_footprint(openings[0], grips[0], p))]
        return [
            [rect.moved(side * far, 0.0, turn) for rect in hand_footprint(opening, grip, p)]
            for grip, side, turn, far, opening in zip(grips, self.sides, self.turns, distances, openings, strict=False)
        ]

    def footprint(self, situation: Situation, p: WorldParameters) -> list[Rect]:
        """Everything that comes down to the target's height."""
        return [rect for hand in self.footprints(situation, False, p) for rect in hand]

    def parts(self, situation: Situation, closed: bool, p: WorldParameters) -> list[Part]:
        """The boxes of the end effector in its start or its end state, as its map shows them."""
        parts = []
        grips = self.grips(situation) or (None,)
        hands = zip(grips, self.footprints(situation, closed, p), self.heights(situation, p), strict=True)
        for grip, rects, tip in hands:
            parts += [Part(rect, tip, tip + p.finger_length_m, self.bare) for rect in rects[:2]]
            if grip is not None:
                bottom = tip + grip.z_m - grip.spec.height_m / 2
                parts += [Part(rect, bottom, bottom + grip.spec.height_m, self.tools_touch) for rect in rects[2:]]
        return parts

    # The attempt

    @abstractmethod
    def can_touch(self, situation: Situation, pose: Pose, p: WorldParameters) -> bool:
        """Whether an action could touch the target at all; where it can't, it is ``missed`` without simulation."""

    @abstractmethod
    def carry_out(self, attempt: Attempt, pose: Pose) -> Grip | Pinch | None:
        """Carry out an action: what its success leaves in the hands for a next step; AttemptFailed where it fails."""

    def approach(self, attempt: Attempt, pose: Pose, low_m: float, path: JointPath) -> None:
        """Put one hand at rest where ``path`` begins, at ``low_m``, or above the target and move it down from there."""
        p, situation, (hand,) = attempt.parameters, attempt.situation, attempt.hands
        (x, y, yaw), (opening,) = pose, self.openings(situation, False, p)
        start, down = low_m, None
        if not clear_of_target(situation, self.footprint(situation, p), pose, CLEAR_M):
            start = self.start_height(situation, p.approach_clearance_m)
        if start > low_m:
            fall = profile(start - low_m, p.descend_speed_m_s, attempt.tick_s, p.ramp_share)
            ends = (x, y, start), (x, y, low_m)
            down = line(hand.arm.base, *ends, yaw, fall, attempt.tick_s, self.symmetric, p)
            down.positions[:, 6] += path.positions[0, 6] - down.positions[-1, 6]  # the same turn of joint 7
        hand.arm.reset((down or path).positions[0], opening)
        self.take(attempt, pose, start)
        if down is not None:
            attempt.descend([down])

    def take(self, attempt: Attempt, pose: Pose, height_m: float) -> None:  # noqa: B027 - most kinds hold nothing
        """Put into the hand what it holds."""

    @abstractmethod
    def goal(self, p: WorldParameters) -> str:
        """What has to be achieved, in words and numbers."""

    def criterion(self, p: WorldParameters = WORLD) -> str:
        """What counts as success, with its thresholds. Part of the protocol: its text must not change."""
        rules = [
            self.goal(p),
            f"a hand or tool that lands on the target with more than {p.stop_force_n:g} N ends the attempt",
        ]
        if not self.bare:
            rules += [
                f"nothing but {self.touching} touches the target",
                f"no tool moves more than {p.max_tool_slip_m:g} m or turns more than {p.max_tool_turn_rad:g} rad "
                "in the hand",
            ]
        return "; ".join(rules)

    # Scenarios and privileged actions

    @abstractmethod
    def spawn(self, rng: np.random.Generator, p: WorldParameters) -> tuple[float, float]:
        """A random place for the target, x and y in m."""

    def aim(self, target: Placement, p: WorldParameters = WORLD) -> tuple[float, float]:
        """Where the scripted policy acts, x and y in m: at the centre of mass."""
        return target.x_m, target.y_m

    def candidates(
        self, target: Placement, valid: Flags, rng: np.random.Generator, p: WorldParameters
    ) -> Iterator[int]:
        """Grid actions of the privileged reference policy, the best first; ``valid`` is bool (65536,) by grid index."""
        return iter(())
