"""Pictures of what a policy sees: scene and end-effector maps, with the action. Needs pillow (extra ``report``)."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from rema_data import grid
from rema_data.errors import InputError
from rema_data.repair import install
from rema_data.schema import HEIGHT_STEP_M, Observation

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

__all__ = [
    "FAINT",
    "GREEN",
    "INK",
    "LEGEND",
    "RED",
    "action_text",
    "end_effector_map",
    "outcome_text",
    "pillow",
    "scene_map",
    "to_png",
    "write_text",
]

Pixels = npt.NDArray[np.float32]
Colour = tuple[int, int, int]

_FINE = 2
"""Drawn so many times larger, then averaged: smooth lines."""
_PAPER: Colour = (255, 255, 255)
INK: Colour = (31, 35, 40)
FAINT: Colour = (101, 109, 118)
GREEN: Colour = (26, 127, 55)
RED: Colour = (180, 35, 24)
_ORANGE: Colour = (217, 119, 6)
_BLUE: Colour = (31, 111, 235)
_GREY: Colour = (140, 149, 159)
_TABLE: Colour = (246, 244, 239)
_OBJECT: Colour = (62, 72, 92)
_TOP_M = 0.05
"""Height that is drawn darkest."""


def action_text(cell: tuple[int, int, int], pose: tuple[float, float, float]) -> str:
    """Grid cell and world pose (m, rad) of an action."""
    (i, j, k), (x_m, y_m, yaw_rad) = cell, pose
    return f"i {i}, j {j}, k {k}: x {x_m * 1000:+.0f} mm, y {y_m * 1000:+.0f} mm, {math.degrees(yaw_rad):g} degrees"


def outcome_text(row: Mapping[str, Any]) -> str:
    """``success``, or the failure label in words."""
    return "success" if row["success"] else str(row["failure"]).replace("_", " ")


def pillow() -> tuple[Any, Any]:
    """Modules ``Image`` and ``ImageDraw`` of pillow; raises InputError where it is not installed."""
    try:
        from PIL import Image, ImageDraw
    except ImportError as error:
        raise InputError(f"pictures need {error.name}, which is not installed", hint=install("rema[report]")) from error
    return Image, ImageDraw


def scene_map(
    observation: Observation,
    pose: tuple[float, float, float],
    push_m: float = 0.0,
    goal_x_m: float | None = None,
    pixels: int = 256,
) -> Image.Image:
    """The scene map, x to the right and y up, with the end effector at the pose (x m, y m, yaw rad) of the action.

    ``push_m`` is how far the action pushes in +x, 0 for a grasp; where the way ends in the map, the end effector is
    drawn there too. ``goal_x_m`` is a line that the target has to pass. ``pixels`` is width and height of the picture.
    """
    image_module, draw_module = pillow()
    size = pixels * _FINE
    step_m = 2 * grid.SCENE_HALF_M / size
    across = (np.arange(size) + 0.5) * step_m - grid.SCENE_HALF_M
    x, y = across[None, :], -across[:, None]
    colours = _shade(observation.scene, _pixel(x, y, grid.SCENE_PIXELS))
    ax, ay, yaw = pose
    end_m = ax + push_m
    for at_x, share in ((ax, 0.45), (end_m, 0.2)) if push_m and end_m < grid.SCENE_HALF_M else ((ax, 0.45),):
        u = math.cos(yaw) * (x - at_x) + math.sin(yaw) * (y - ay)
        v = -math.sin(yaw) * (x - at_x) + math.cos(yaw) * (y - ay)
        place = _pixel(u, v, grid.EE_PIXELS)
        body, allowed = observation.depth[0][place] > 0, observation.mask[0][place]
        inside = (abs(u) < grid.EE_HALF_M) & (abs(v) < grid.EE_HALF_M)
        colours = _tint(colours, inside & body & ~allowed, _GREY, share)
        colours = _tint(colours, inside & allowed, _BLUE, share)
    image: Image.Image = image_module.fromarray(colours.astype(np.uint8))
    draw = draw_module.Draw(image)

    def at(x_m: float, y_m: float) -> tuple[float, float]:
        return (x_m + grid.SCENE_HALF_M) / step_m, (grid.SCENE_HALF_M - y_m) / step_m

    edge = grid.SCENE_HALF_M - grid.VALID_MARGIN * grid.PIXEL_M
    draw.rectangle((*at(-edge, edge), *at(edge, -edge)), outline=(205, 199, 189), width=_FINE)
    if goal_x_m is not None:
        draw.line((*at(goal_x_m, -grid.SCENE_HALF_M), *at(goal_x_m, grid.SCENE_HALF_M)), fill=GREEN, width=2 * _FINE)
    if push_m:
        _arrow(draw, at(ax, ay), at(min(end_m, grid.SCENE_HALF_M - 0.004), ay), INK, 1.4)
    _arrow(draw, at(ax, ay), at(ax + 0.04 * math.cos(yaw), ay + 0.04 * math.sin(yaw)), _ORANGE, 2.2)
    _dot(draw, at(ax, ay), 3.4, _ORANGE)
    draw.rectangle((0, 0, size - 1, size - 1), outline=_GREY, width=_FINE)
    return image.resize((pixels, pixels), image_module.Resampling.BOX)


def end_effector_map(
    observation: Observation, state: int, pixels: int, planes: Sequence[str] = ("depth", "mask")
) -> Image.Image:
    """One state of the end-effector map at yaw 0: grey bodies (depth), blue where they may touch the target (mask)."""
    image_module, draw_module = pillow()
    zoom = _zoom(observation.depth)
    size = pixels * _FINE
    across = ((np.arange(size) + 0.5) / size * 2 - 1) * grid.EE_HALF_M / zoom
    place = _pixel(across[None, :], -across[:, None], grid.EE_PIXELS)
    depth = observation.depth[state] if "depth" in planes else np.zeros_like(observation.depth[state])
    colours = _shade(depth, place)
    if "mask" in planes:
        colours = _tint(colours, observation.mask[state][place], _BLUE, 0.65)
    image: Image.Image = image_module.fromarray(colours.astype(np.uint8))
    draw_module.Draw(image).rectangle((0, 0, size - 1, size - 1), outline=_GREY, width=_FINE)
    image = image.resize((pixels, pixels), image_module.Resampling.BOX)
    named = f": {planes[0]}" if len(planes) == 1 else ""
    enlarged = f", {zoom} x" if zoom > 1 else ""
    write_text(draw_module.Draw(image), (5, 3), f"state {state + 1}{named}{enlarged}", 10, FAINT)
    return image


def _zoom(depth: npt.NDArray[np.uint16]) -> int:
    """How much both states can be enlarged about their middle so that every body stays in the picture."""
    _, rows, columns = np.nonzero(depth)
    half = grid.EE_PIXELS // 2
    reach = max((abs(2 * index + 1 - 2 * half).max() + 1) // 2 for index in (rows, columns)) if len(rows) else half
    return next(zoom for zoom in (4, 2, 1) if zoom == 1 or reach * zoom <= 0.9 * half)


def _pixel(x_m: npt.NDArray[Any], y_m: npt.NDArray[Any], pixels: int) -> tuple[Any, Any]:
    """Row and column of the map pixel at a place, clipped to the map."""
    row, column = (
        np.clip(np.floor(value / grid.PIXEL_M + pixels / 2).astype(int), 0, pixels - 1) for value in (y_m, x_m)
    )
    return row, column


def _shade(heights: npt.NDArray[np.uint16], place: tuple[Any, Any]) -> Pixels:
    share = np.clip(heights.astype(np.float32) * np.float32(HEIGHT_STEP_M / _TOP_M), 0, 1)[place][..., None]
    shaded: Pixels = (1 - share) * np.array(_TABLE, np.float32) + share * np.array(_OBJECT, np.float32)
    return shaded


def _tint(colours: Pixels, where: npt.NDArray[np.bool_], colour: Colour, share: float) -> Pixels:
    tinted: Pixels = np.where(where[..., None], (1 - share) * colours + share * np.array(colour, np.float32), colours)
    return tinted


def _arrow(
    draw: ImageDraw.ImageDraw, start: tuple[float, float], end: tuple[float, float], colour: Colour, width: float
) -> None:
    """An arrow with a white rim."""
    (x, y), (ex, ey) = start, end
    length = math.hypot(ex - x, ey - y)
    if length < 1:
        return
    head = min(4.2 * width * _FINE, length)
    dx, dy = (ex - x) / length, (ey - y) / length
    neck = (ex - dx * head, ey - dy * head)
    for rim, paint in ((1.3, _PAPER), (0.0, colour)):
        wide = (width + 2 * rim) * _FINE
        draw.line((*start, *neck), fill=paint, width=round(wide))
        side = head * 0.45 + rim * _FINE
        tip = (ex + dx * rim * 2 * _FINE, ey + dy * rim * 2 * _FINE)
        back = (neck[0] - dx * rim * _FINE, neck[1] - dy * rim * _FINE)
        draw.polygon(
            [tip, (back[0] - dy * side, back[1] + dx * side), (back[0] + dy * side, back[1] - dx * side)], fill=paint
        )


def _dot(draw: ImageDraw.ImageDraw, centre: tuple[float, float], radius: float, colour: Colour) -> None:
    x, y = centre
    for reach, paint in (((radius + 1.2) * _FINE, _PAPER), (radius * _FINE, colour)):
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), fill=paint)


def write_text(
    draw: ImageDraw.ImageDraw, place: tuple[float, float], text: str, size: float, colour: Colour, anchor: str = "la"
) -> None:
    """Write one line, ``size`` in pixels; see pillow's ``anchor``."""
    from PIL import ImageFont

    draw.text(place, text, fill=colour, font=ImageFont.load_default(size), anchor=anchor)


LEGEND: tuple[tuple[Colour, str], ...] = (
    (_ORANGE, "the action: place and yaw"),
    (INK, "the way of a push"),
    (_BLUE, "may touch the target"),
    (_GREY, "may not"),
    (_OBJECT, "the target; darker is higher"),
)
"""Colours of a scene map (red, green, blue), and what they mean."""


def to_png(image: Image.Image) -> bytes:
    """A PNG file."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
