"""One step as a picture: what the policy saw, what it did, and the world before and after.

::

    find_step    scenario + policy or action  ->  the step to show (situation, action)
    play         situation + action           ->  outcome, and the poses before and after it
    draw         a played step                ->  the picture

Needs matplotlib and pillow, which belong to the extra ``report``.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluator.render.studio import COLOUR_NAMES, Marker, Shot, shot_of_stage, shot_of_world
from evaluator.sim.kinds import kind_of
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import acting_arm, valid_actions
from evaluator.sim.simulator import Simulator
from evaluator.sim.staging import HandPose, Thing, target_thing
from rema_data import grid
from rema_data.errors import InputError
from rema_data.schema import Action, Failure, ObjectSpec, Scenario, Situation, StepOutcome
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from evaluator.policy.loading import PolicySpec

__all__ = [
    "EVIDENCE",
    "Played",
    "asked",
    "check_action",
    "find_scenario",
    "find_step",
    "markers",
    "play",
    "roles",
    "touching",
    "waiting_shot",
    "write_preview",
]

BEFORE_CLEARANCE_M = 0.09
"""How far above the target hands and tools wait in the picture before the action."""
_AIM = (0.12, 0.12, 0.14, 1.0)
_LINE = (0.05, 0.62, 0.20, 1.0)
_SQUARE = (0.66, 0.62, 0.56, 1.0)


@dataclass(frozen=True, slots=True)
class Played:
    """A step that was carried out.

    Attributes
    ----------
    situation : Situation
    action : int
        Grid index.
    outcome : StepOutcome
    before, after : Shot
        Hands above the place of the action; the moment in which the attempt ended.
    """

    situation: Situation
    action: int
    outcome: StepOutcome
    before: Shot
    after: Shot


def find_scenario(task: str, index: int, split: str, protocol: str) -> Scenario:
    """A frozen scenario.

    Raises
    ------
    InputError
        The list is not that long, or the scenario has no tools in hand for the conditional protocol.
    MissingFileError, IntegrityError
        The list cannot be read.
    """
    from evaluator.scenarios import load_list, reference_pinch, reference_tools

    scenarios = load_list(task, split).scenarios
    if not 0 <= index < len(scenarios):
        raise InputError(
            f"there is no scenario {index} in the {split} list of {task}",
            hint=f"choose one from 0 to {len(scenarios) - 1}",
            index=index,
        )
    scenario = scenarios[index]
    incomplete = len(scenario.grips) < reference_tools(task) or (reference_pinch(task) and scenario.pinch is None)
    if protocol == "conditional" and incomplete:
        raise InputError(
            f"the reference policy could not pick up the tools of scenario {index}, so its last step has no start",
            hint="choose another scenario, or --protocol end-to-end",
            index=index,
        )
    return scenario


def check_action(situation: Situation, i: int, j: int, k: int) -> int:
    """Grid index of a row, column and angle.

    Raises
    ------
    InputError
        The action is off the grid, or no arm can carry it out at this step.
    """
    valid = valid_actions(situation.task, situation.step)
    rows, columns, angles = valid.shape
    if not (0 <= i < rows and 0 <= j < columns and 0 <= k < angles):
        raise InputError(
            f"action {i},{j},{k} is off the grid",
            hint=f"rows and columns go from 0 to {rows - 1}, angles from 0 to {angles - 1}",
            action=(i, j, k),
        )
    if not valid[i, j, k]:
        low, high = grid.VALID_MARGIN, grid.SCENE_PIXELS - grid.VALID_MARGIN - 1
        last = situation.kind.angles - 1
        raise InputError(
            f"no arm can carry out action {i},{j},{k} at this step",
            hint=f"rows and columns from {low} to {high}, angles from 0 to {last}; nearer to the middle is easier",
            action=(i, j, k),
        )
    return int(grid.encode(i, j, k))


@contextmanager
def asked(policy: PolicySpec, checkpoint: Path | None = None) -> Iterator[Any]:
    """A running policy as a function from a situation to its action.

    Raises
    ------
    SubmissionError
        The policy cannot be loaded; or, from the function, it gave no valid answer.
    """
    from evaluator.policy import ObservationBatch, PolicyFault, PolicyHost
    from rema_data.errors import SubmissionError

    with PolicyHost(policy, checkpoint) as host:

        def answer(situation: Situation) -> int:
            valid = valid_actions(situation.task, situation.step)
            batch = ObservationBatch.of(situation, [observe(situation)], valid)
            (action,) = host.act(batch, (situation,) if host.privileged else None)
            if isinstance(action, PolicyFault):
                raise SubmissionError(
                    f"policy {policy.name} gave no action: {action.reason}: {action.detail}",
                    hint=f"mend {policy.path} and run the same command again",
                )
            return int(action)

        yield answer


def find_step(scenario: Scenario, protocol: str, answer: Any) -> tuple[Situation, int]:
    """The step to show, and its action: the last one (conditional), or the one at which the episode ends.

    Parameters
    ----------
    scenario : Scenario
    protocol : {"conditional", "end-to-end"}
    answer : callable
        From a Situation to a grid index.
    """
    if protocol == "conditional":
        situation = scenario.last_situation()
        return situation, answer(situation)
    simulator = Simulator()
    try:
        situation = scenario.first_situation()
        while True:
            action = answer(situation)
            if situation.last:
                return situation, action
            outcome = simulator.run(situation, action)
            if not outcome.success:
                return situation, action
            situation = scenario.next_situation(situation, outcome)
    finally:
        simulator.close()


def play(situation: Situation, action: int) -> Played:
    """Carry out a step, and keep what it looked like before and after."""
    arm = acting_arm(situation.task, situation.step, action)
    before = waiting_shot(situation, action)
    if arm is None:
        return Played(situation, action, StepOutcome(False, Failure.UNREACHABLE), before, before)
    simulator = Simulator()
    try:
        outcome = simulator.run(situation, action)
        if outcome.sim_steps == 0 and outcome.failure is Failure.MISSED:
            # the outcome was clear without simulation; the picture needs one all the same
            simulator.close()
            simulator = Simulator(shortcuts=False)
            simulator.run(situation, action)
        after = before
        if outcome.failure is not Failure.UNREACHABLE:
            after = shot_of_world(simulator.world, roles(situation))
    finally:
        simulator.close()
    return Played(situation, action, outcome, before, after)


def roles(situation: Situation) -> list[tuple[str, ObjectSpec]]:
    """Objects of a simulated step, in the order in which the simulator places them: for ``shot_of_world``."""
    _, things = _staged(situation, 0, "left")
    return [(thing.role, thing.spec) for thing in things]


def touching(situation: Situation) -> str:
    """What may touch the target, in words, with its colour in the pictures."""
    kind = kind_of(situation)
    return kind.touching if kind.role is None else f"{kind.touching} ({COLOUR_NAMES[kind.role]})"


def waiting_shot(situation: Situation, action: int) -> Shot:
    """The picture before an action: what acts waits ``BEFORE_CLEARANCE_M`` above its place."""
    arm = acting_arm(situation.task, situation.step, action) or "left"
    return shot_of_stage(*_staged(situation, action, arm), kind_of(situation).symmetric)


def _staged(situation: Situation, action: int, arm: str) -> tuple[list[HandPose], list[Thing]]:
    """Hands that wait above the place of an action, and all objects: the target first."""
    kind, pose = kind_of(situation), Action(action).pose
    hands = kind.hands(situation, pose, kind.start_height(situation, BEFORE_CLEARANCE_M), arm)
    return hands, [target_thing(situation), *kind.held(situation, hands, pose)]


def markers(situation: Situation, action: int) -> list[Marker]:
    """Bars on the table: the valid square, the place of the action, and for a push its way and the line to pass."""
    x, y, yaw = (float(value) for value in grid.to_world(action))
    edge = grid.SCENE_HALF_M - grid.VALID_MARGIN * grid.PIXEL_M
    thin = 0.0012
    found = [Marker(s * edge, 0.0, thin, edge, 0.0, _SQUARE) for s in (-1, 1)]
    found += [Marker(0.0, s * edge, edge, thin, 0.0, _SQUARE) for s in (-1, 1)]
    way = kind_of(situation).reach_shifts(WORLD)[-1]
    if way:
        found.append(Marker(x + way / 2, y, way / 2, 0.0015, 0.0, _AIM))
        for turn in (-1, 1):
            tip = turn * math.radians(150)
            found.append(Marker(x + way + 0.014 * math.cos(tip), y + 0.014 * math.sin(tip), 0.015, 0.0015, tip, _AIM))
        target = situation.target
        found.append(Marker(target.x_m + WORLD.push_success_m, target.y_m, 0.003, 0.10, 0.0, _LINE))
    else:
        found += [Marker(x, y, 0.016, 0.0012, yaw, _AIM), Marker(x, y, 0.0012, 0.016, yaw, _AIM)]
    return found


def write_preview(played: Played, path: Path, title: str, colours: int | None = None) -> None:
    """Draw a step into a PNG file.

    Parameters
    ----------
    played : Played
    path : Path
    title : str
        Which episode this is.
    colours : int, optional
        Reduce the picture to so many colours: a much smaller file.

    Raises
    ------
    InputError
        matplotlib or pillow is not installed, or the file name has another suffix.
    StorageError
        The file cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"{path} is not a PNG file", hint=f"write --output {path.with_suffix('.png')}", path=str(path))
    try:
        from PIL import Image

        from evaluator.render.drawing import draw
    except ImportError as error:
        raise InputError(
            f"pictures need {error.name}, which is not installed", hint='pip install "rema[report]"'
        ) from error
    picture = Image.fromarray(draw(played, title))
    if colours is not None:
        picture = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.FLOYDSTEINBERG)
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    write_atomic(path, buffer.getvalue())


EVIDENCE = {
    Failure.MISSED: "nothing that may touch the target touched it",
    Failure.BLOCKED: "the descent landed on the target: protective stop",
    Failure.NOT_LIFTED: "touched, but never carried",
    Failure.SLIPPED: "left the table and was lost before the end",
    Failure.ILLEGAL_CONTACT: "touched by something that must not touch it",
    Failure.TOO_LITTLE: f"pushed less than {WORLD.push_success_m * 100:.0f} cm in +x",
    Failure.TOOL_LOST: "a tool left the hand",
    Failure.UNREACHABLE: "outside the arms' joint limits",
    Failure.UNSTABLE: "the physics left its range of validity",
}
"""What a failure label means, in words."""
