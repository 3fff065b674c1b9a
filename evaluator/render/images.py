"""Pictures as text for a page: photographs, short animations, and maps, each a ``data:`` URL.

Needs pillow and matplotlib, which belong to the extra ``report``.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from evaluator.render.film import SHOT_EVERY, Take, markers
from evaluator.render.studio import CLOSE_UP, Studio
from evaluator.sim.kinds import kind_of
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD
from rema_data import grid
from rema_data.pictures import scene_map, to_png
from rema_data.schema import Action, Situation

__all__ = ["FILM", "MAP_PIXELS", "PHOTO", "Photographs", "draw_action", "draw_scores", "film", "photograph", "stills"]

PHOTO = (480, 360)
FILM = (360, 270)
"""Width and height of a photograph and of an animation, pixels."""
MAP_PIXELS = 256
FRAMES = 18
"""Of an animation at most."""
_SLOWER = 1.5
"""An animation takes so many times the simulated time."""
_LAST_FRAME_MS = 1500
_QUALITY = 78
_SCORE_COLOURS = "magma"
_RING = ((9, 4, (0, 0, 0)), (8, 2, (255, 255, 255)))
"""Around the chosen place: radius, width and colour, readable on every colour of a map."""


@dataclass(frozen=True, slots=True)
class Photographs:
    """A take in pictures, as ``data:`` URLs; ``after`` and ``film`` are None where no arm moved."""

    before: str
    after: str | None
    film: str | None


def photograph(studio: Studio, take: Take) -> Photographs:
    """Before, after, and a short animation between them."""
    return Photographs(*stills(studio, take), film(studio, take))


def stills(studio: Studio, take: Take) -> tuple[str, str | None]:
    """Photographs before and after a take, as ``data:`` URLs; the second is None where no arm moved."""
    shots = [take.before, take.after] if take.shots else [take.before]
    shown = markers(take.situation, take.action)
    before, *after = (_webp(studio.picture(shot, shown, PHOTO, CLOSE_UP)) for shot in shots)
    return before, after[0] if after else None


def film(studio: Studio, take: Take) -> str | None:
    """A short animation of a take, as a ``data:`` URL; None where no arm moved."""
    if not take.shots:
        return None
    shown = markers(take.situation, take.action)
    count = min(FRAMES, len(take.shots))
    chosen = np.linspace(0, len(take.shots) - 1, count).round().astype(int)
    frames = [studio.picture(take.shots[number], shown, FILM, CLOSE_UP) for number in chosen]
    return _animation(frames, len(take.shots) * SHOT_EVERY * WORLD.time_step_s * _SLOWER)


def draw_action(situation: Situation, action: int) -> str:
    """The scene map with an action (a grid index) and what acts, 256 pixels wide, as a ``data:`` URL."""
    way_m = kind_of(situation).reach_shifts(WORLD)[-1]
    picture = scene_map(observe(situation), Action(action).pose, way_m, pixels=MAP_PIXELS)
    return _url("image/png", to_png(picture.quantize(64, dither=Image.Dither.NONE)))


def draw_scores(best: npt.NDArray[np.float32], action: int) -> str:
    """A map of scores as colours from dark (0) to bright (1), the chosen place ringed, as a ``data:`` URL.

    ``best``, float32 (64, 64), has the score of every place, NaN where no angle is valid; ``action`` is a grid index.
    """
    colours = matplotlib.colormaps[_SCORE_COLOURS](np.nan_to_num(best).clip(0, 1), bytes=True)[..., :3]
    colours[np.isnan(best)] = 120
    zoom = MAP_PIXELS // grid.SCENE_PIXELS
    picture = Image.fromarray(np.ascontiguousarray(np.kron(colours[::-1], np.ones((zoom, zoom, 1), np.uint8))))
    i, j, _ = (int(value) for value in grid.decode(action))
    x, y = (j + 0.5) * zoom, MAP_PIXELS - (i + 0.5) * zoom
    draw = ImageDraw.Draw(picture)
    for radius, width, colour in _RING:
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=colour, width=width)
    return _webp(picture)


def _animation(frames: Sequence[Image.Image], seconds: float) -> str:
    each = max(40, round(seconds * 1000 / len(frames)))
    durations = [each] * (len(frames) - 1) + [_LAST_FRAME_MS]
    return _webp(frames[0], save_all=True, append_images=frames[1:], duration=durations, loop=0, minimize_size=False)


def _webp(picture: Image.Image, **options: Any) -> str:
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", quality=_QUALITY, **options)
    return _url("image/webp", buffer.getvalue())


def _url(kind: str, payload: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(payload).decode()}"
