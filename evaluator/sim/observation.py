"""What a policy sees: height maps painted directly from the known geometry.

The same maps come from cameras (``cameras.py``: one view of the scene, four fused views of the end effector); painting
them from the boxes is exact, thousands of times cheaper, and repeats bit for bit. No PyBullet here: the judge observes
without a simulator alive.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evaluator.sim.footprints import (
    finger_footprint,
    hand_footprints,
    inner_extents,
    pair_heights,
    pinched_heights,
)
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.planar import Rect, paint
from evaluator.sim.shapes import boxes, footprint, held_footprint
from rema_data.grid import EE_HALF_M, EE_PIXELS, SCENE_HALF_M, SCENE_PIXELS
from rema_data.schema import HEIGHT_STEP_M, Embodiment, Observation, Primitive, Situation

SLAB_M = 0.05
"""Height of the end-effector map's bounds (paper, Table 1): what is higher than this above the lowest allowed point is
cut off, so a finger shows as a full 0.05 m."""


class Part(NamedTuple):
    """A box of the end effector in the map's frame: footprint, bottom and top (m, one common zero), may it touch."""

    rect: Rect
    bottom_m: float
    top_m: float
    allowed: bool


def observe(situation: Situation, parameters: WorldParameters = WORLD) -> Observation:
    """Scene and end-effector maps before an action.

    Parameters
    ----------
    situation : Situation
    parameters : WorldParameters

    Returns
    -------
    Observation
        Heights in units of 0.1 mm. The end-effector maps are centred on the tool centre point (one hand) or on the
        pair's origin (two hands), at yaw 0.
    """
    scene = np.zeros((SCENE_PIXELS, SCENE_PIXELS), np.uint16)
    height = round(situation.target.spec.height_m / HEIGHT_STEP_M)
    for rect in footprint(situation.target):
        paint(scene, rect, height, SCENE_HALF_M)
    depth = np.zeros((2, EE_PIXELS, EE_PIXELS), np.uint16)
    mask = np.zeros((2, EE_PIXELS, EE_PIXELS), np.bool_)
    states = end_effector_states(situation, parameters)
    for state, parts in enumerate(states):
        if state and parts is states[0]:
            depth[1], mask[1] = depth[0], mask[0]
        else:
            depth[state], mask[state] = paint_parts(parts)
    return Observation(scene, depth, mask)


def paint_parts(parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Depth (uint16, 0.1 mm above the lowest allowed point, cut at 5 cm) and mask of one state, each (112, 112)."""
    floor = min(part.bottom_m for part in parts if part.allowed)
    depth = np.zeros((EE_PIXELS, EE_PIXELS), np.uint16)
    allowed = np.zeros((EE_PIXELS, EE_PIXELS), np.uint16)
    for part in parts:
        if part.bottom_m - floor >= SLAB_M:
            continue
        top = round(min(part.top_m - floor, SLAB_M) / HEIGHT_STEP_M)
        paint(depth, part.rect, top, EE_HALF_M)
        if part.allowed:
            paint(allowed, part.rect, top, EE_HALF_M)
    return depth, (allowed > 0) & (allowed >= depth)


def end_effector_states(situation: Situation, p: WorldParameters = WORLD) -> tuple[list[Part], list[Part]]:
    """The boxes of the end effector in its two states (start, end); the same list twice where nothing closes."""
    kind, grips = situation.kind, situation.grips
    if kind.embodiment is Embodiment.GRIPPER:
        closed = _fingers(finger_footprint(0.0, p), 0.0, True, p)
        if kind.primitive is Primitive.PUSH:
            return closed, closed
        return _fingers(finger_footprint(p.opening_max_m, p), 0.0, True, p), closed
    if kind.embodiment is Embodiment.TOOL:
        (grip,) = grips
        bottom = grip.z_m - grip.spec.height_m / 2
        tool = [Part(rect, bottom, bottom + grip.spec.height_m, True) for rect in held_footprint(grip)]
        parts = _fingers(finger_footprint(grip.opening_m, p), 0.0, False, p) + tool
        return parts, parts
    if kind.embodiment is Embodiment.STICKS:
        left, right = inner_extents(grips)
        heights = pair_heights(grips, p.pair_clearance_m)
        opened = _pair(situation, (left + p.pair_open_m, right + p.pair_open_m), heights, True, p)
        return opened, _pair(situation, (left, right), heights, True, p)
    pinch = situation.pinch
    assert pinch is not None
    heights = pinched_heights(grips, pinch, p)
    parts = _pair(situation, (pinch.left_m, pinch.right_m), heights, False, p)
    bottom = min(heights) + pinch.z_m - pinch.spec.height_m / 2
    parts += [
        Part(box.moved(pinch.x_m, pinch.y_m, pinch.yaw_rad), bottom, bottom + pinch.spec.height_m, True)
        for box in boxes(pinch.spec)
    ]
    return parts, parts


def _fingers(rects: Sequence[Rect], tip_m: float, allowed: bool, p: WorldParameters) -> list[Part]:
    return [Part(rect, tip_m, tip_m + p.finger_length_m, allowed) for rect in rects]


def _pair(
    situation: Situation,
    distances: tuple[float, float],
    heights: tuple[float, float],
    sticks_allowed: bool,
    p: WorldParameters,
) -> list[Part]:
    parts: list[Part] = []
    hands = hand_footprints(situation.grips, distances, p)
    for grip, rects, tip in zip(situation.grips, hands, heights, strict=True):
        bottom = tip + grip.z_m - grip.spec.height_m / 2
        parts += _fingers(rects[:2], tip, False, p)
        parts += [Part(rect, bottom, bottom + grip.spec.height_m, sticks_allowed) for rect in rects[2:]]
    return parts


__all__ = ["SLAB_M", "Part", "end_effector_states", "observe", "paint_parts"]
