"""The records that flow through rema: one set of types for the simulator, the store, the sampler and the evaluator.

Frames
------
world
    Metres, z up, table top z = 0, origin at the centre of the workspace, +x the push direction.
object
    Origin at the centre of mass, x along the main bar.
hand
    Origin at the tool centre point (between the fingertips, at their lower end), x the closing axis of the jaws,
    z up. The yaw of a hand is the yaw of its closing axis.
pair
    Origin midway between the tips of the two held sticks, x from the right hand's stick to the left hand's.
"""

from __future__ import annotations

import dataclasses
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from rema_data import grid
from rema_data.errors import InputError

if TYPE_CHECKING:
    from rema_data.variation import Variation

SCHEMA_VERSION = 2
"""Of the stored tables that are read: the newest ``since`` of a column in ``rema_data.store.columns``."""

HEIGHT_STEP_M = 1e-4
"""Resolution of a stored height: maps are canonical multiples of 0.1 mm."""


class Shape(StrEnum):
    """The three seed shapes (paper, section 4), then those of the suites and of varied episodes."""

    I = "I"
    L = "L"
    T = "T"
    U = "U"
    Z = "Z"
    PLUS = "plus"
    Y = "Y"
    RING = "ring"
    H = "H"
    COMB = "comb"
    EIGHT = "eight"
    F = "F"
    HOOK = "hook"
    RAKE = "rake"


SEED_SHAPES = (Shape.I, Shape.L, Shape.T)
"""The shapes of the paper, of clean episodes, and of the clean scenario lists."""


class Primitive(StrEnum):
    """The two action primitives, one network each."""

    GRASP = "grasp"
    PUSH = "push"


class Embodiment(StrEnum):
    """What touches the target: bare fingers, a held tool, two held sticks, or an object pinched between two sticks."""

    GRIPPER = "gripper"
    TOOL = "tool"
    STICKS = "sticks"
    PINCHED = "pinched"

    @property
    def two_arms(self) -> bool:
        """Whether both arms act as one, which halves the range of angles."""
        return self in (Embodiment.STICKS, Embodiment.PINCHED)

    @property
    def bare(self) -> bool:
        """Whether the fingers themselves touch the target: nothing is held."""
        return self is Embodiment.GRIPPER


class StepKind(NamedTuple):
    """What one step of a task asks for. ``evaluator.sim.kinds`` carries it out."""

    primitive: Primitive
    embodiment: Embodiment

    @property
    def angles(self) -> int:
        """Number of angles that an action may have: those from 0 on."""
        return grid.PAIR_ANGLES if self.embodiment.two_arms else grid.ANGLES

    @property
    def makes(self) -> Literal["tool", "pinch"] | None:
        """What a success leaves in the hands for the next step: a tool, an object between two sticks, or nothing."""
        if self.primitive is not Primitive.GRASP:
            return None
        return "pinch" if self.embodiment.two_arms else "tool"


class Task(NamedTuple):
    """A task: its steps in order, and a number that never changes, since it keys what is drawn and how blocks lie."""

    number: int
    steps: tuple[StepKind, ...]


_PICK = StepKind(Primitive.GRASP, Embodiment.GRIPPER)
_PUSH = StepKind(Primitive.PUSH, Embodiment.GRIPPER)
_TOOL_PUSH = StepKind(Primitive.PUSH, Embodiment.TOOL)
_PINCER = StepKind(Primitive.GRASP, Embodiment.STICKS)
_PINCHED_PUSH = StepKind(Primitive.PUSH, Embodiment.PINCHED)

_TABLE = {
    "grasp": Task(0, (_PICK,)),
    "push": Task(1, (_PUSH,)),
    "grasp_grasp": Task(2, (_PICK, _PICK, _PINCER)),
    "grasp_push": Task(3, (_PICK, _TOOL_PUSH)),
    "grasp_grasp_push": Task(4, (_PICK, _PICK, _PINCER, _PINCHED_PUSH)),
}

TASKS: dict[str, tuple[StepKind, ...]] = {name: task.steps for name, task in _TABLE.items()}
"""Steps of every task, in order. An episode ends at its first failed step (paper, section 3.3)."""

TASK_NUMBERS: dict[str, int] = {name: task.number for name, task in _TABLE.items()}
"""Number of every task. Nothing depends on the order of ``TASKS`` but the order in which tasks are listed."""


def skill(kind: StepKind) -> str:
    """Name of what a step exercises: the task whose last step is of this kind. A tool pick is a ``grasp``."""
    return min((task for task, steps in TASKS.items() if steps[-1] == kind), key=TASK_NUMBERS.__getitem__)


def tool_steps(task: str) -> tuple[int, ...]:
    """Steps of a task whose object becomes a tool in one hand: the left one first."""
    return tuple(n for n, kind in enumerate(TASKS[task][:-1]) if kind.makes == "tool")


def pinch_step(task: str) -> int | None:
    """The step of a task whose object is pinched between two sticks for the steps after it, if there is one."""
    return next((n for n, kind in enumerate(TASKS[task][:-1]) if kind.makes == "pinch"), None)


class Failure(StrEnum):
    """Why a step failed: exactly one label for every failed step."""

    MISSED = "missed"  # nothing that may touch the target touched it
    BLOCKED = "blocked"  # the descent landed on the target: protective stop
    NOT_LIFTED = "touched_not_lifted"  # touched, but never carried
    SLIPPED = "slipped"  # left the table and was lost before the end
    ILLEGAL_CONTACT = "illegal_contact"  # touched by something that must not touch it
    TOO_LITTLE = "displaced_too_little"  # pushed less than the required distance in +x
    TOOL_LOST = "tool_lost"  # a tool left the hand
    UNREACHABLE = "unreachable"  # outside the arm's joint limits
    UNSTABLE = "unstable"  # the physics left its range of validity
    POLICY_ERROR = "policy_error"  # the policy raised, hung or answered with something that is not an action


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """An object made of boxes: an I, L or T, or a shape of a suite (``evaluator.sim.shapes``)."""

    shape: Shape
    length_m: float  # of the main bar
    width_m: float  # of every bar
    arm_m: float  # extent of the other bars across the main one, the main bar's width included; 0 for an I
    height_m: float


@dataclass(frozen=True, slots=True)
class Placement:
    """An object at rest on the table: pose of its centre of mass in the world frame."""

    spec: ObjectSpec
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Grip:
    """A tool in a hand: pose of its centre of mass in the hand frame, and the gap between the fingers."""

    spec: ObjectSpec
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    opening_m: float


@dataclass(frozen=True, slots=True)
class Pinch:
    """An object held between two sticks: pose of its centre of mass in the pair frame, and where the hands are."""

    spec: ObjectSpec
    x_m: float
    y_m: float
    z_m: float  # height of the centre of mass above the tool centre points
    yaw_rad: float
    left_m: float  # distance of the left hand's tool centre point from the pair's origin, along +x of the pair
    right_m: float  # of the right hand's, along -x


@dataclass(frozen=True, slots=True)
class Situation:
    """What one step starts from: everything the simulator needs besides the action."""

    task: str
    step: int  # 0-based position in ``TASKS[task]``
    target: Placement  # the object of this step
    grips: tuple[Grip, ...] = ()  # tools in hand: the first in the left hand when there are two
    pinch: Pinch | None = None
    variation: Variation | None = None  # of a varied last step: what is other than in the clean protocol

    @property
    def kind(self) -> StepKind:
        """Primitive and embodiment of this step."""
        return TASKS[self.task][self.step]

    @property
    def last(self) -> bool:
        """Whether success here is success of the task."""
        return self.step == len(TASKS[self.task]) - 1


@dataclass(frozen=True, slots=True)
class Scenario:
    """One frozen episode: an object for every step, and the tools in hand of the conditional protocol.

    The identity of a scenario is (task, split, index, list version).
    """

    task: str
    split: str
    index: int  # position in its list, 0-based
    placements: tuple[Placement, ...]  # the object of every step, in order
    grips: tuple[Grip, ...] = ()  # as the reference policy picked them; empty where the task has no tools
    pinch: Pinch | None = None  # as the reference policy pinched it, for ``grasp_grasp_push``
    variation: Variation | None = None  # of a scenario of a suite or a varied episode, whose last step it changes

    def last_situation(self) -> Situation:
        """The last step, with the scenario's tools in hand (conditional protocol)."""
        return self._situation(len(self.placements) - 1, self.grips, self.pinch)

    def first_situation(self) -> Situation:
        """The first step, with empty hands (end-to-end protocol)."""
        return self._situation(0)

    def next_situation(self, done: Situation, outcome: StepOutcome) -> Situation:
        """The step after ``done``, which succeeded with ``outcome``."""
        step = done.step + 1
        grips = done.grips if outcome.grip is None else (*done.grips, outcome.grip)
        return self._situation(step, grips, outcome.pinch)

    def _situation(self, step: int, grips: tuple[Grip, ...] = (), pinch: Pinch | None = None) -> Situation:
        variation = self.variation if step == len(self.placements) - 1 else None
        return Situation(self.task, step, self.placements[step], grips, pinch, variation)


@dataclass(frozen=True, slots=True)
class Observation:
    """What a policy sees before one action.

    Attributes
    ----------
    scene : uint16 (64, 64)
        Height above the table in units of 0.1 mm.
    depth : uint16 (2, 112, 112)
        Height of the end effector above its lowest allowed point, two states, in units of 0.1 mm, at yaw 0.
    mask : bool (2, 112, 112)
        Whether the topmost body at a pixel is allowed to touch the target.
    """

    scene: npt.NDArray[np.uint16]
    depth: npt.NDArray[np.uint16]
    mask: npt.NDArray[np.bool_]

    def scene_m(self) -> npt.NDArray[np.float32]:
        """Scene height map, float32 (64, 64), metres."""
        return (self.scene * np.float32(HEIGHT_STEP_M)).astype(np.float32)

    def end_effector(self) -> npt.NDArray[np.float32]:
        """End-effector map, float32 (112, 112, 4): depth (m) and mask of state 1, depth and mask of state 2."""
        planes = np.empty((4, grid.EE_PIXELS, grid.EE_PIXELS), np.float32)
        planes[0::2] = self.depth * np.float32(HEIGHT_STEP_M)
        planes[1::2] = self.mask
        return np.moveaxis(planes, 0, -1)


@dataclass(frozen=True, slots=True)
class Action:
    """One action of the 64 x 64 x 16 grid."""

    index: int  # 0..65535: ``(i * 64 + j) * 16 + k``

    @property
    def cell(self) -> tuple[int, int, int]:
        """Row i, column j and angle k."""
        i, j, k = grid.decode(self.index)
        return int(i), int(j), int(k)

    @property
    def pose(self) -> tuple[float, float, float]:
        """World pose: x (m), y (m) and yaw (rad) of the hand, or of the pair where two arms act as one."""
        x_m, y_m, yaw_rad = grid.to_world(self.index)
        return float(x_m), float(y_m), float(yaw_rad)


def _measured(default: Any, meaning: str, unit: str = "", frame: str = "", since: int = 1) -> Any:
    """A field of Evidence, with what its column says of itself."""
    return field(default=default, metadata={"meaning": meaning, "unit": unit, "frame": frame, "since": since})


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What was measured in one step: each field is a column of every table of steps, and carries its meaning.

    A new field is nullable (``float | None``) with the default ``None``, and names the schema version that adds it:
    ``since``; raise ``SCHEMA_VERSION`` too. In the rows of earlier releases it is null.
    """

    arm: str = _measured("none", "left, right, both, or none where nothing had to be simulated")
    displacement_m: float = _measured(0.0, "of the target's centre of mass in +x, at rest", "m", "world")
    lift_m: float = _measured(0.0, "highest rise of the target's centre of mass", "m", "world")
    peak_force_n: float = _measured(0.0, "largest normal force on the hand or tool during the descent", "N")
    contact_steps: int = _measured(0, "simulation steps in which an allowed body touched the target")
    illegal_steps: int = _measured(0, "simulation steps in which a forbidden body touched the target")
    sim_steps: int = _measured(0, "simulation steps taken")

    def evidence(self) -> dict[str, Any]:
        """Names and values of what was measured."""
        return {name: getattr(self, name) for name in EVIDENCE}


EVIDENCE = tuple(item.name for item in dataclasses.fields(Evidence))
"""Names of the fields of ``Evidence``, in order."""


@dataclass(frozen=True, slots=True)
class StepOutcome(Evidence):
    """What one action did, and what was measured of it."""

    success: bool
    failure: Failure | None  # exactly one label when ``success`` is false, else None
    _: KW_ONLY
    grip: Grip | None = None  # the picked object as a tool, after a successful pick that is not the last step
    pinch: Pinch | None = None  # likewise after a successful pincer that is not the last step


@dataclass(frozen=True, slots=True)
class Step:
    """One executed step: what the simulator was given, what the policy saw and did, and the outcome."""

    situation: Situation
    observation: Observation
    action: Action
    outcome: StepOutcome
    policy: str  # name of the behaviour policy of this step
    policy_digest: str  # sha256 of its code and weights


@dataclass(frozen=True, slots=True)
class Episode:
    """The executed steps of one collected episode, up to its first failure."""

    task: str
    round: int  # collection round, from 1
    split: str  # ``train`` or ``val``
    index: int  # position in its (round, task, split), from 0
    seed: int  # root seed of the collection; with task, round, split and index it keys everything that was drawn
    steps: tuple[Step, ...]
    variation: Variation | None = None  # what its last step changes, whether that was reached or not

    @property
    def success(self) -> bool:
        """Whether the last step of the task was reached and succeeded."""
        return self.steps[-1].situation.last and self.steps[-1].outcome.success

    @property
    def failure(self) -> Failure | None:
        """Label of the step that ended the episode, or None after a success."""
        return self.steps[-1].outcome.failure


def to_dict(record: Any) -> dict[str, Any]:
    """A record as plain dictionaries, tuples, strings and numbers, ready for JSON.

    The same as ``dataclasses.asdict`` in a quarter of the time: it runs for every question and every outcome of a run.
    """
    return {name: _plain(getattr(record, name)) for name in _field_names(record.__class__)}


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, (float, int, str)):
        return value
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return to_dict(value) if dataclasses.is_dataclass(value) else value


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(item.name for item in dataclasses.fields(kind))


def outcome_from_dict(row: dict[str, Any]) -> StepOutcome:
    """Inverse of ``to_dict`` for a ``StepOutcome``."""
    fields = dict(row)
    fields["failure"] = None if row["failure"] is None else Failure(row["failure"])
    for name, kind in (("grip", Grip), ("pinch", Pinch)):
        if row.get(name) is not None:
            fields[name] = kind(**{**row[name], "spec": spec_from_dict(row[name]["spec"])})
    return StepOutcome(**fields)


def spec_from_dict(row: dict[str, Any]) -> ObjectSpec:
    """Inverse of ``to_dict`` for an ``ObjectSpec``."""
    return ObjectSpec(**{**row, "shape": Shape(row["shape"])})


def check_task(task: str) -> str:
    """``task`` itself, or an InputError that lists the tasks."""
    if task not in TASKS:
        raise InputError(f"unknown task {task!r}", hint=f"choose one of: {', '.join(TASKS)}", task=task)
    return task
