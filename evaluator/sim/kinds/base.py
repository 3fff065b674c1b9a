"""What every kind of step answers, and what kinds with the same primitive or the same number of arms share.

A kind is a stateless object. It combines a primitive (``GraspKind``, ``PushKind``) with ``OneArm`` or ``TwoArms``, and
adds what is its own. No PyBullet is needed to ask it anything but ``carry_out``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from evaluator.sim.attempt import POLL_EVERY, Attempt, AttemptFailed
from evaluator.sim.footprints import finger_footprint, hand_footprint
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.planar import Rect
from evaluator.sim.shapes import held_footprint
from evaluator.sim.staging import HandPose, Part, Pose, Thing, turned
from rema_data.schema import Failure, Grip, Pinch, Placement, Situation, StepKind

__all__ = ["TOOL_HEIGHTS_M", "GraspKind", "Kind", "OneArm", "PushKind", "hand_parts"]

Flags = npt.NDArray[np.bool_]

TOOL_HEIGHTS_M = (0.0, 0.03)
"""Heights of the tool centre point between which a held tool's lowest point is at its clearance."""


class Kind(ABC):
    """One kind of step.

    Attributes
    ----------
    step : StepKind
        The name of this kind in the schema.
    acting, touching : str
        In words: what acts ("a tool"), and the only thing that may touch the target ("the held tool").
    role : str or None
        Role of the thing that may touch the target (see ``Thing``); None for the fingers.
    measure : str
        The field of ``Evidence`` that success is measured by.
    closes : bool
        Whether the end effector closes, so that its two states differ.
    symmetric : bool
        Whether half a turn of the hand makes no difference.
    """

    step: ClassVar[StepKind]
    acting: ClassVar[str]
    touching: ClassVar[str]
    role: ClassVar[str | None] = None
    measure: ClassVar[str]
    closes: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False

    @property
    def two_arms(self) -> bool:
        """Whether both arms act as one."""
        return self.step.embodiment.two_arms

    @property
    def bare(self) -> bool:
        """Whether the fingers may touch the target; otherwise they must not, and something is held."""
        return self.step.embodiment.bare

    # Reach: an arm must get to every combination of these

    @abstractmethod
    def reach_distances(self, p: WorldParameters) -> tuple[float, ...]:
        """Distances of a hand from the action's place, m."""

    @abstractmethod
    def reach_heights(self, p: WorldParameters) -> tuple[float, ...]:
        """Heights of the tool centre point, m."""

    @abstractmethod
    def reach_shifts(self, p: WorldParameters) -> tuple[float, ...]:
        """Points of the hand's way along +x, m; the last one is its end."""

    @abstractmethod
    def hand_yaws(self, theta: Any) -> tuple[Any, Any]:
        """Yaw of the left and of the right hand for an action angle (rad)."""

    # Staging: where hands and held things stand

    @abstractmethod
    def hands(
        self,
        situation: Situation,
        pose: Pose,
        height_m: float,
        arm: str = "left",
        closed: bool = False,
        p: WorldParameters = WORLD,
    ) -> list[HandPose]:
        """Poses of the hands that act.

        Parameters
        ----------
        situation : Situation
        pose : (x, y, yaw)
            Of the tool centre point, or of the pair's origin; m, rad.
        height_m : float
            Height of one tool centre point; for a pair, of the zero from which its hands are raised.
        arm : str
            Which arm acts where only one does.
        closed : bool
            The end state (jaws or sticks closed) instead of the start state.
        """

    def held(self, situation: Situation, hands: list[HandPose], pose: Pose) -> list[Thing]:
        """What hands at these poses hold, in the order in which it is put there: tools, then a pinched object."""
        things = []
        for hand, grip in zip(hands, self.grips(situation), strict=False):
            x, y = turned((hand.x_m, hand.y_m, hand.yaw_rad), grip.x_m, grip.y_m)
            things.append(Thing("tool", grip.spec, x, y, hand.z_m + grip.z_m, hand.yaw_rad + grip.yaw_rad))
        return things

    def grips(self, situation: Situation) -> tuple[Grip, ...]:
        """The tools that take part."""
        return () if self.bare else situation.grips

    def start_height(self, situation: Situation, clearance_m: float) -> float:
        """``height_m`` of hands that keep everything held ``clearance_m`` above the target's top."""
        return situation.target.spec.height_m + clearance_m

    # Maps

    @abstractmethod
    def parts(self, situation: Situation, closed: bool, p: WorldParameters) -> list[Part]:
        """The boxes of the end effector in its start or its end state, as its map shows them."""

    # The attempt

    @abstractmethod
    def can_touch(self, situation: Situation, pose: Pose, p: WorldParameters) -> bool:
        """Whether an action could touch the target at all; where it can't, it is ``missed`` without simulation."""

    @abstractmethod
    def carry_out(self, attempt: Attempt, pose: Pose) -> Grip | Pinch | None:
        """Carry out an action; raises AttemptFailed where it fails.

        Returns
        -------
        Grip, Pinch or None
            What this success leaves in the hands for the next step, if there is one.
        """

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
        """Grid actions of the privileged reference policy, the best first; none where it has no part.

        Parameters
        ----------
        target : Placement
        valid : bool (65536,)
            By grid index.
        rng : numpy.random.Generator
        p : WorldParameters
        """
        return iter(())


class GraspKind(Kind):
    """A step that lifts the target."""

    measure = "lift_m"
    closes = True

    def reach_shifts(self, p: WorldParameters) -> tuple[float, ...]:
        """The hand goes nowhere but up."""
        return (0.0,)

    @abstractmethod
    def success_lift_m(self, p: WorldParameters) -> float:
        """How high the target has to be."""

    def goal(self, p: WorldParameters) -> str:
        """The target is held, high enough."""
        return (
            f"{p.hold_steps} simulation steps after the lift, the target's centre of mass is at least "
            f"{self.success_lift_m(p):g} m higher than on the table, and the target is still held"
        )

    def spawn(self, rng: np.random.Generator, p: WorldParameters) -> tuple[float, float]:
        """Anywhere in the square."""
        x, y = (float(value) for value in rng.uniform(-p.grasp_spawn_half_m, p.grasp_spawn_half_m, 2))
        return x, y


class PushKind(Kind):
    """A step that moves the target in +x."""

    measure = "displacement_m"

    def reach_shifts(self, p: WorldParameters) -> tuple[float, ...]:
        """Start, middle and end of the push."""
        return 0.0, p.push_distance_m / 2, p.push_distance_m

    def goal(self, p: WorldParameters) -> str:
        """The target has moved far enough."""
        return f"at rest, the target's centre of mass is at least {p.push_success_m:g} m further in +x than before"

    def spawn(self, rng: np.random.Generator, p: WorldParameters) -> tuple[float, float]:
        """Further to +x, with room behind."""
        x = float(rng.uniform(p.push_spawn_x_min_m, p.push_spawn_x_max_m))
        return x, float(rng.uniform(-p.push_spawn_half_y_m, p.push_spawn_half_y_m))

    def aim(self, target: Placement, p: WorldParameters = WORLD) -> tuple[float, float]:
        """A constant offset behind the centre of mass."""
        return target.x_m - p.scripted_push_offset_m, target.y_m

    def settle(self, attempt: Attempt) -> None:
        """Wait, a bounded number of steps, until the target is at rest."""
        for _ in range(attempt.parameters.settle_steps // POLL_EVERY):
            if attempt.world.speed(attempt.target) < attempt.parameters.rest_speed_m_s:
                return
            attempt.step(POLL_EVERY)

    def check_moved(self, attempt: Attempt, start_x_m: float) -> None:
        """Success is a displacement of at least 10 cm in +x, at the end, with every tool still in hand."""
        moved = attempt.world.pose(attempt.target)[0] - start_x_m
        attempt.note(displacement_m=moved)
        if not attempt.tools_held():
            raise AttemptFailed(Failure.TOOL_LOST)
        if moved < attempt.parameters.push_success_m:
            raise AttemptFailed(Failure.TOO_LITTLE if attempt.evidence.contact_steps else Failure.MISSED)


class OneArm(Kind):
    """A step of one hand, which turns with the action; what it holds, if anything, is one tool."""

    @abstractmethod
    def opening(self, situation: Situation, closed: bool, p: WorldParameters) -> float:
        """Gap between the fingers, m."""

    def grip(self, situation: Situation) -> Grip | None:
        """The tool that takes part."""
        return next(iter(self.grips(situation)), None)

    def footprint(self, situation: Situation, p: WorldParameters) -> tuple[Rect, ...]:
        """Fingers and tool in the hand frame, as they come down."""
        return hand_footprint(self.opening(situation, False, p), self.grip(situation), p)

    def reach_distances(self, p: WorldParameters) -> tuple[float, ...]:
        """The hand is at the action's place."""
        return (0.0,)

    def hand_yaws(self, theta: Any) -> tuple[Any, Any]:
        """The closing axis turns with the action."""
        return theta, theta

    def hands(
        self,
        situation: Situation,
        pose: Pose,
        height_m: float,
        arm: str = "left",
        closed: bool = False,
        p: WorldParameters = WORLD,
    ) -> list[HandPose]:
        """One hand at the action's place."""
        x, y, yaw = pose
        return [HandPose(arm, x, y, height_m, yaw, self.opening(situation, closed, p))]

    def parts(self, situation: Situation, closed: bool, p: WorldParameters) -> list[Part]:
        """Fingers, and the tool if one is held."""
        fingers = finger_footprint(self.opening(situation, closed, p), p)
        grip = self.grip(situation)
        return hand_parts(fingers, () if grip is None else held_footprint(grip), grip, 0.0, self.bare, True, p)


def hand_parts(
    fingers: tuple[Rect, ...],
    tool: tuple[Rect, ...],
    grip: Grip | None,
    tip_m: float,
    fingers_allowed: bool,
    tool_allowed: bool,
    p: WorldParameters,
) -> list[Part]:
    """Boxes of a hand whose tool centre point is at height ``tip_m``, and of the tool in it."""
    parts = [Part(rect, tip_m, tip_m + p.finger_length_m, fingers_allowed) for rect in fingers]
    if grip is not None:
        bottom = tip_m + grip.z_m - grip.spec.height_m / 2
        parts += [Part(rect, bottom, bottom + grip.spec.height_m, tool_allowed) for rect in tool]
    return parts
