"""Steps of a release as a sheet of pictures (PNG) or a page (HTML): observation, action and outcome of each."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rema_data.errors import InputError
from rema_data.gallery import GalleryStep
from rema_data.pictures import (
    FAINT,
    GREEN,
    INK,
    LEGEND,
    RED,
    action_text,
    end_effector_map,
    outcome_text,
    pillow,
    scene_map,
    to_png,
    write_text,
)
from rema_data.schema import TASKS
from rema_data.storage import write_atomic
from rema_data.store.tables import variation_of

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

__all__ = ["SUFFIXES", "contact_sheet", "describe", "tile", "write_pictures"]

SUFFIXES = (".png", ".html")
_SCENE, _HAND, _GAP, _MARGIN = 256, 124, 8, 12
"""Screen pixels of a scene map, of an end-effector map, between them, and around them."""
_HEAD, _FOOT = 42, 42
_TILE = (_MARGIN * 2 + _SCENE + _GAP + _HAND, _HEAD + _SCENE + _FOOT)
_PAGE = (233, 231, 226)


def describe(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Where a step comes from, who acted, the action, and the evidence, each in one line."""
    steps, variation = len(TASKS[row["task"]]), variation_of(row)
    evidence = f"lifted {row['lift_m'] * 100:.1f} cm"
    if row["primitive"] == "push":
        evidence = f"moved {row['displacement_m'] * 100:+.1f} cm in x"
    if row["peak_force_n"] >= 0.5:
        evidence += f", {row['peak_force_n']:.0f} N"
    return (
        f"{row['task']}, step {row['step'] + 1} of {steps}",
        f"round {row['round']} {row['split']}, episode {row['episode']}, {row['policy']}"
        + (f", {variation.cell}" if variation is not None else ""),
        action_text((row["i"], row["j"], row["k"]), (row["x_m"], row["y_m"], row["theta_rad"])),
        f"{evidence}, {row['sim_steps']} simulation steps",
    )


def tile(step: GalleryStep) -> Image.Image:
    """One step: scene map with the action, end-effector maps, and captions."""
    image_module, draw_module = pillow()
    row = step.row
    image: Image.Image = image_module.new("RGB", _TILE, "white")
    pose = row["x_m"], row["y_m"], row["theta_rad"]
    push_m = math.inf if row["primitive"] == "push" else 0.0
    image.paste(scene_map(step.observation, pose, push_m), (_MARGIN, _HEAD))
    for state in range(2):
        panel = end_effector_map(step.observation, state, _HAND)
        image.paste(panel, (_MARGIN + _SCENE + _GAP, _HEAD + state * (_HAND + _GAP)))
    draw = draw_module.Draw(image)
    colour = GREEN if row["success"] else RED
    draw.rectangle((0, 0, _TILE[0], 3), fill=colour)
    place, who, action, evidence = describe(row)
    write_text(draw, (_MARGIN, 6), place, 14, INK)
    write_text(draw, (_MARGIN, 23), who, 11, FAINT)
    write_text(draw, (_TILE[0] - _MARGIN, 6), outcome_text(row), 14, colour, "ra")
    write_text(draw, (_MARGIN, _HEAD + _SCENE + 6), action, 11, INK)
    write_text(draw, (_MARGIN, _HEAD + _SCENE + 21), evidence, 11, FAINT)
    return image


def contact_sheet(steps: Sequence[GalleryStep], title: str, columns: int = 3) -> Image.Image:
    """Several steps in one picture, ``columns`` side by side."""
    image_module, draw_module = pillow()
    if not steps:
        raise InputError("there are no steps to draw", hint="choose some that exist")
    columns = max(1, min(columns, len(steps)))
    rows = -(-len(steps) // columns)
    top = 40
    size = columns * (_TILE[0] + _MARGIN) + _MARGIN, top + rows * (_TILE[1] + _MARGIN) + _HEAD
    sheet: Image.Image = image_module.new("RGB", size, _PAGE)
    draw = draw_module.Draw(sheet)
    write_text(draw, (_MARGIN, 12), title, 16, INK)
    for number, step in enumerate(steps):
        row, column = divmod(number, columns)
        sheet.paste(tile(step), (_MARGIN + column * (_TILE[0] + _MARGIN), top + row * (_TILE[1] + _MARGIN)))
    _legend(draw, (_MARGIN, size[1] - 26))
    return sheet


def write_pictures(steps: Sequence[GalleryStep], path: Path, title: str, columns: int = 3) -> None:
    """Write a contact sheet (``.png``), or a page that needs no other file (``.html``).

    Raises
    ------
    InputError
        pillow is not installed, or the file has another suffix.
    StorageError
        The file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"{path} is neither a PNG nor an HTML file",
            hint=f"write --output {path.with_suffix('.png')}",
            path=str(path),
        )
    if suffix == ".png":
        write_atomic(path, to_png(contact_sheet(steps, title, columns)))
    else:
        write_atomic(path, _page(steps, title))


def _legend(draw: ImageDraw.ImageDraw, place: tuple[float, float]) -> None:
    from PIL import ImageFont

    x, y = place
    font = ImageFont.load_default(11)
    for colour, text in LEGEND:
        draw.rectangle((x, y, x + 11, y + 11), fill=colour)
        draw.text((x + 17, y - 1), text, fill=INK, font=font)
        x += 40 + draw.textlength(text, font=font)


def _page(steps: Iterable[GalleryStep], title: str) -> str:
    """HTML with every picture inside it."""
    figures = []
    for step in steps:
        data = base64.b64encode(to_png(tile(step))).decode()
        words = html.escape(", ".join((*describe(step.row)[:2], outcome_text(step.row))))
        size = f'width="{_TILE[0]}" height="{_TILE[1]}"'
        figures.append(f'<img {size} alt="{words}" title="{words}" src="data:image/png;base64,{data}">')
    keys = " ".join(f'<i style="background:rgb{colour}"></i>{html.escape(text)}' for colour, text in LEGEND)
    style = (
        f"body{{font:15px system-ui,sans-serif;background:rgb{_PAGE};color:rgb{INK};margin:24px}}"
        "main{display:flex;flex-wrap:wrap;gap:12px}h1{font-size:20px}p{font-size:13px}"
        "i{display:inline-block;width:11px;height:11px;margin:0 6px 0 18px}i:first-child{margin-left:0}"
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>\n'
        f"<style>{style}</style>\n<h1>{html.escape(title)}</h1>\n<p>{keys}</p>\n<main>\n"
        + "\n".join(figures)
        + "\n</main></html>\n"
    )
