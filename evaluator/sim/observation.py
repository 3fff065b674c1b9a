"""What a policy sees: height maps painted directly from the known geometry.

Cameras would show the same (the tests compare with one view of the scene and four fused views of the end effector);
painting from the boxes is exact, thousands of times cheaper, and repeats bit for bit. No PyBullet here: the evaluator
observes without a simulator alive.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from evaluator.sim.kinds import kind_of
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.planar import paint
from evaluator.sim.sense import sensed
from evaluator.sim.shapes import footprint
from evaluator.sim.staging import Part
from evaluator.sim.varied import parameters_of, standing
from rema_data.grid import EE_HALF_M, EE_PIXELS, SCENE_HALF_M, SCENE_PIXELS
from rema_data.schema import HEIGHT_STEP_M, Observation, Situation

__all__ = ["SLAB_M", "end_effector_states", "observation_sha256", "observe", "paint_parts"]

SLAB_M = 0.05
"""Height of the end-effector map's bounds (paper, Table 1): what is higher than this above the lowest allowed point is
cut off, so a finger shows as a full 0.05 m."""


def observe(situation: Situation, parameters: WorldParameters = WORLD) -> Observation:
    """Scene and end-effector maps before an action, heights in units of 0.1 mm.

    The end-effector maps are centred on the tool centre point (one hand) or on the pair's origin (two hands), at yaw 0.
    """
    parameters = parameters_of(situation, parameters)
    scene = np.zeros((SCENE_PIXELS, SCENE_PIXELS), np.uint16)
    for placement in standing(situation):
        height = round(placement.spec.height_m / HEIGHT_STEP_M)
        for rect in footprint(placement):
            paint(scene, rect, height, SCENE_HALF_M)
    depth = np.zeros((2, EE_PIXELS, EE_PIXELS), np.uint16)
    mask = np.zeros((2, EE_PIXELS, EE_PIXELS), np.bool_)
    start, end = end_effector_states(situation, parameters)
    depth[0], mask[0] = depth[1], mask[1] = paint_parts(start)
    if end is not start:
        depth[1], mask[1] = paint_parts(end)
    seen = Observation(scene, depth, mask)
    if situation.variation is None or situation.variation.sense is None:
        return seen
    return sensed(seen, situation.variation.sense)


def observation_sha256(seen: Observation) -> str:
    """sha256 of the maps, hexadecimal: scene, depths (uint16, little endian), then the masks, a bit a pixel."""
    found = hashlib.sha256(seen.scene.astype("<u2").tobytes())
    found.update(seen.depth.astype("<u2").tobytes())
    found.update(np.packbits(seen.mask).tobytes())
    return found.hexdigest()


def paint_parts(parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Depth (uint16, 0.1 mm above the lowest allowed point, cut at 5 cm) and mask of one state, each (112, 112).

    Not to be written to: bare hands are those of many situations, and are painted once.
    """
    return _painted(tuple(parts))


@lru_cache(maxsize=64)
def _painted(parts: tuple[Part, ...]) -> tuple[np.ndarray, np.ndarray]:
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
    mask = (allowed > 0) & (allowed >= depth)
    depth.flags.writeable = mask.flags.writeable = False
    return depth, mask


def end_effector_states(situation: Situation, p: WorldParameters = WORLD) -> tuple[list[Part], list[Part]]:
    """The boxes of the end effector in its two states (start, end); the same list twice where nothing closes."""
    kind = kind_of(situation)
    start = kind.parts(situation, False, p)
    return start, kind.parts(situation, True, p) if kind.closes else start
