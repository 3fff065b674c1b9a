"""Pictures of steps: everything that was seen and done is in them, at its place."""

from __future__ import annotations

import base64
import builtins
import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rema_data import grid, pictures, sheets
from rema_data.errors import InputError, StorageError
from rema_data.gallery import GalleryStep
from rema_data.pictures import outcome_text
from rema_data.schema import TASKS, Action
from rema_data.sheets import contact_sheet, describe, tile, write_pictures
from rema_data.store.block import BlockKey
from rema_data.store.tables import step_row
from rema_data.testing import synthetic_episode

BLUE, ORANGE = np.array(pictures._BLUE), np.array(pictures._ORANGE)


def shown(task: str, position: int = 0, action: int | None = None, success: float = 1.0) -> GalleryStep:
    """A step of a synthetic episode that got so far."""
    for index in range(200):
        episode = synthetic_episode(BlockKey(1, task, "train"), index, success=success)
        if len(episode.steps) > position:
            step = episode.steps[position]
            if action is not None:
                step = dataclasses.replace(step, action=Action(action))
            row = {"peak_force_n": 0.0, "variation": None, **step_row(episode, step, 0, 0)}
            return GalleryStep(row, step.observation)
    raise AssertionError("no episode got so far")


STEPS = [(task, position) for task, steps in TASKS.items() for position in range(len(steps))]


@pytest.mark.parametrize(("task", "position"), STEPS)
def test_every_kind_of_step_has_a_picture(task: str, position: int) -> None:
    image = np.asarray(tile(shown(task, position)))
    assert image.shape == (*sheets._TILE[::-1], 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
    assert np.abs(image.astype(int) - ORANGE).sum(-1).min() < 10


def scene_panel(step: GalleryStep) -> np.ndarray:
    """The scene map of a tile, row 0 at the lowest y."""
    top, left = sheets._HEAD, sheets._MARGIN
    return np.asarray(tile(step))[top : top + sheets._SCENE, left : left + sheets._SCENE][::-1].astype(int)


@pytest.mark.parametrize(("i", "j"), [(8, 50), (32, 32), (55, 10)])
def test_the_action_is_drawn_at_its_pixel(i: int, j: int) -> None:
    panel = scene_panel(shown("grasp", action=int(grid.encode(i, j, 4))))
    rows, columns = np.nonzero(np.abs(panel - ORANGE).sum(-1) < 10)
    centre = (np.array([i, j]) + 0.5) * sheets._SCENE / grid.SCENE_PIXELS
    assert np.hypot(rows - centre[0], columns - centre[1]).min() < 2
    # Angle 4 is a quarter turn: the arrow points to +y.
    assert rows.max() > centre[0] + 25
    assert rows.min() > centre[0] - 8
    assert abs(columns - centre[1]).max() < 8


def test_the_target_is_drawn_where_it_is() -> None:
    step = shown("grasp", action=int(grid.encode(6, 6, 0)))
    scene = np.zeros((64, 64), np.uint16)
    scene[50:56, 40:46] = 300
    seen = dataclasses.replace(step.observation, scene=scene, depth=np.zeros_like(step.observation.depth))
    panel = scene_panel(GalleryStep(step.row, dataclasses.replace(seen, mask=np.zeros_like(seen.mask))))
    dark = panel[2:-2, 2:-2].sum(-1) < 480
    rows, columns = np.nonzero(dark & (panel[2:-2, 2:-2].std(-1) < 30))
    scale = sheets._SCENE / grid.SCENE_PIXELS
    assert np.allclose([rows.min() + 2, rows.max() + 3], [50 * scale, 56 * scale], atol=1)
    assert np.allclose([columns.min() + 2, columns.max() + 3], [40 * scale, 46 * scale], atol=1)


def test_the_mask_is_tinted() -> None:
    step = shown("grasp")
    for allowed in (True, False):
        mask = np.zeros_like(step.observation.mask)
        depth = np.zeros_like(step.observation.depth)
        depth[:, 40:70, 40:70] = 300
        mask[:, 40:70, 40:70] = allowed
        image = np.asarray(tile(GalleryStep(step.row, dataclasses.replace(step.observation, depth=depth, mask=mask))))
        panel = image[sheets._HEAD :, -sheets._MARGIN - sheets._HAND : -sheets._MARGIN].astype(int)
        blueish = (panel[..., 2] - panel[..., 0] > 80).sum()
        assert (blueish > 1000) == allowed


@pytest.mark.parametrize("won", [True, False])
def test_the_colour_says_the_outcome(won: bool) -> None:
    step = shown("push", success=float(won))
    colour = tuple(np.asarray(tile(step))[1, 5])
    assert colour == (pictures.GREEN if won else pictures.RED)
    assert (outcome_text(step.row) == "success") == won


def test_the_captions() -> None:
    row = {**shown("grasp_push", 1).row, "displacement_m": 0.123, "peak_force_n": 7.6, "sim_steps": 200}
    row |= {"episode": 4, "policy": "random", "i": 10, "j": 20, "k": 2, "x_m": -0.05175, "y_m": 0.1, "theta_rad": 0.785}
    place, who, action, evidence = describe(row)
    assert place == "grasp_push, step 2 of 2"
    assert who == "round 1 train, episode 4, random"
    assert action.startswith("i 10, j 20, k 2: x -52 mm, y +100 mm, 44.9")
    assert evidence == "moved +12.3 cm in x, 8 N, 200 simulation steps"
    assert describe({**row, "primitive": "grasp", "lift_m": 0.3})[3].startswith("lifted 30.0 cm")
    assert outcome_text({"success": False, "failure": "displaced_too_little"}) == "displaced too little"


def test_a_sheet_holds_every_tile() -> None:
    steps = [shown("grasp", action=int(grid.encode(20 + n, 20, n))) for n in range(5)]
    sheet = np.asarray(contact_sheet(steps, "five", columns=3))
    for step in steps:
        wanted = np.asarray(tile(step))
        height, width = wanted.shape[:2]
        band = (sheet == wanted[0, 0]).all(-1)
        corners = np.argwhere(band[1:, 1:] & ~band[:-1, 1:] & ~band[1:, :-1]) + 1
        assert any(np.array_equal(sheet[top : top + height, left : left + width], wanted) for top, left in corners)
    assert contact_sheet(steps[:1], "one").size[0] < sheet.shape[1] / 2
    with pytest.raises(InputError, match="no steps"):
        contact_sheet([], "none")


def test_the_same_steps_are_the_same_bytes(tmp_path: Path) -> None:
    steps = [shown("grasp_grasp", n) for n in range(3)]
    for suffix in sheets.SUFFIXES:
        for name in "ab":
            write_pictures(steps, tmp_path / f"{name}{suffix}", "title")
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_a_page_holds_its_pictures_and_no_markup_of_others(tmp_path: Path) -> None:
    step = shown("push")
    step = GalleryStep({**step.row, "policy": '<script>"&'}, step.observation)
    write_pictures([step, shown("grasp")], tmp_path / "page.html", "<b>title</b>")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>" not in page
    assert "<b>" not in page
    assert not re.search(r'(src|href)="(?!data:image/png;base64,)', page)
    sources = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(sources) == 2
    for source in sources:
        with Image.open(io.BytesIO(base64.b64decode(source))) as picture:
            assert picture.size == sheets._TILE


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.gif is neither a PNG nor an HTML file") as caught:
        write_pictures([shown("grasp")], tmp_path / "a.gif", "title")
    assert "a.png" in caught.value.hint
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_a_storage_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot write"):
        write_pictures([shown("grasp")], tmp_path / "file" / "a.png", "title")


def test_without_pillow_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name.startswith("PIL"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match="pictures need PIL") as caught:
        write_pictures([shown("grasp")], tmp_path / "a.png", "title")
    assert 'pip install "rema[report]"' in caught.value.hint
