"""One step as a picture: what the policy saw, what it did, and the world before and after.

Needs pillow, which belongs to the extra ``report``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from evaluator.render.film import Take, markers
from evaluator.render.studio import Studio
from evaluator.render.words import FAILURES, measured_text, touching_text
from evaluator.rollout.ask import actions, ask
from evaluator.rollout.backend import default_backend
from evaluator.sim.kinds import kind_of
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import valid_actions
from rema_data import grid, pictures
from rema_data.errors import InputError, SubmissionError
from rema_data.schema import Action, Situation, to_dict
from rema_data.storage import write_atomic

if TYPE_CHECKING:
    from PIL import Image

    from evaluator.policy import PolicyFault, PolicySpec

__all__ = ["HEIGHT", "WIDTH", "check_action", "chosen_by", "draw", "write_preview"]

WIDTH, HEIGHT = 1280, 900
_PHOTO = (636, 477)
_MAP, _PLANE = 290, 220
_COLUMN = 372
"""Where the end-effector maps and the captions begin."""
_TOP = 562


def check_action(situation: Situation, i: int, j: int, k: int) -> int:
    """Grid index of a row, column and angle; InputError where it is off the grid or no arm can carry it out."""
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
def chosen_by(policy: PolicySpec, checkpoint: Path | None = None) -> Iterator[Callable[[Situation], int]]:
    """A running policy as a function from a situation to its action; both raise SubmissionError where it fails."""
    from evaluator.policy import PolicyHost

    def no_action(_: int, fault: PolicyFault) -> SubmissionError:
        return SubmissionError(
            f"policy {policy.name} gave no action: {fault.reason}: {fault.detail}",
            hint=f"fix {policy.path} and run the same command again",
        )

    with PolicyHost(policy, checkpoint) as host:
        yield lambda situation: actions(ask(host, default_backend(), [situation]), no_action)[0]


def write_preview(take: Take, path: Path, title: str, colours: int | None = None) -> None:
    """Draw a step into a PNG file (fewer ``colours``: smaller); InputError without Pillow or for another suffix."""
    if path.suffix.lower() != ".png":
        raise InputError(f"{path} is not a PNG file", hint=f"write --output {path.with_suffix('.png')}", path=str(path))
    picture = draw(take, title)
    if colours is not None:
        from PIL import Image

        picture = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.FLOYDSTEINBERG)
    write_atomic(path, pictures.to_png(picture))


def draw(take: Take, title: str) -> Image.Image:
    """The picture of a step, 1280 x 900: two photographs, the maps, the action, the outcome. Needs Pillow."""
    situation, outcome, observation = take.situation, take.outcome, observe(take.situation)
    way_m = kind_of(situation).reach_shifts(WORLD)[-1]
    scene = pictures.scene_map(
        observation,
        Action(take.action).pose,
        way_m,
        situation.target.x_m + WORLD.push_success_m if way_m else None,
        _MAP,
    )
    from PIL import Image, ImageDraw

    picture = Image.new("RGB", (WIDTH, HEIGHT), "white")
    pen = ImageDraw.Draw(picture)

    def write(x: float, y: float, text: str, size: float = 15, anchor: str = "la") -> None:
        pictures.write_text(pen, (x, y), text, size, pictures.INK, anchor)

    write(14, 12, title, 21)
    word = "SUCCESS" if outcome.success else f"FAILED: {outcome.failure}"
    pictures.write_text(pen, (WIDTH - 14, 12), word, 21, pictures.GREEN if outcome.success else pictures.RED, "ra")
    after = f"after: {pictures.outcome_text(to_dict(outcome))}"
    with Studio() as studio:
        for left, shot, text in ((2, take.before, "before"), (642, take.after, after)):
            photo = studio.picture(shot, markers(situation, take.action), _PHOTO)
            picture.paste(photo, (left, 48))
            pen.rectangle((left + 8, 54, left + 22 + pen.textlength(text, font_size=16), 78), fill="white")
            write(left + 14, 57, text, 16)
    picture.paste(scene, (54, _TOP))
    write(54 + _MAP / 2, _TOP - 6, "scene map, 64 x 64, and the action", 13, "ms")
    for mm in (-100, 0, 100):
        place = mm / 1000 / (2 * grid.SCENE_HALF_M) * _MAP
        write(54 + _MAP / 2 + place, _TOP + _MAP + 4, str(mm), 11, "ma")
        write(50, _TOP + _MAP / 2 - place, str(mm), 11, "rm")
    write(54 + _MAP / 2, _TOP + _MAP + 19, "x, mm (push direction); y, mm, to the left", 11, "ma")
    for number, (state, plane) in enumerate((state, plane) for state in (0, 1) for plane in ("depth", "mask")):
        panel = pictures.end_effector_map(observation, state, _PLANE, (plane,))
        picture.paste(panel, (_COLUMN + number * (_PLANE + 7), _TOP))
    write(_COLUMN, _TOP - 6, "end-effector map, 112 x 112: bodies, and where they may touch the target", 13, "ls")
    for number, text in enumerate(_caption(take)):
        write(_COLUMN, 798 + number * 26, text, 16)
    return picture


def _caption(take: Take) -> list[str]:
    situation, outcome, action = take.situation, take.outcome, Action(take.action)
    arm = {"both": "both arms", "none": "no arm"}.get(outcome.arm, f"the {outcome.arm} arm")
    why = "" if outcome.failure is None else f"{FAILURES[outcome.failure]}; "
    return [
        f"step {situation.step + 1}: {situation.kind.primitive}; {touching_text(situation.kind)} may touch the target "
        f"(red, {situation.target.spec.shape})",
        f"action {pictures.action_text(action.cell, action.pose)}; {arm}",
        f"{why}{measured_text(situation.kind, outcome.evidence())}",
    ]
