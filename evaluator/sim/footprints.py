"""Footprints of hands and held tools, seen from above: pure geometry shared by attempts and maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import footprint, held_footprint
from evaluator.sim.varied import standing
from rema_data.schema import Grip, Situation

SIDES = (1.0, -1.0)
"""Left hand along +x of the pair frame, right hand along -x."""
HAND_TURNS = (math.pi / 2, 3 * math.pi / 2)
"""Yaw of the left and the right hand in the pair frame."""


def finger_footprint(opening_m: float, parameters: WorldParameters) -> tuple[Rect, Rect]:
    """Footprints of the two fingers in the hand frame."""
    half_thick, half_wide = parameters.finger_thickness_m / 2, parameters.finger_lateral_m / 2
    x = opening_m / 2 + half_thick
    return Rect(x, 0, 0, half_thick, half_wide), Rect(-x, 0, 0, half_thick, half_wide)


def hand_footprint(opening_m: float, grip: Grip | None, parameters: WorldParameters) -> tuple[Rect, ...]:
    """Footprints of fingers and held tool in the hand frame: all that reaches down to an object's height."""
    fingers = finger_footprint(opening_m, parameters)
    return fingers if grip is None else (*fingers, *held_footprint(grip))


def clear_of_target(
    situation: Situation, footprints: Sequence[Rect], pose: tuple[float, float, float], margin_m: float
) -> bool:
    """Whether footprints, moved to a world pose (x, y, yaw), keep ``margin_m`` away from all that stands there."""
    moved = [rect.moved(*pose) for rect in footprints]
    return all(gap(moved, footprint(placement)) > margin_m for placement in standing(situation))


def lowest_point(grip: Grip | None) -> float:
    """Height of the lowest point of fingers and held tool above the tool centre point (0 or negative)."""
    return 0.0 if grip is None else min(0.0, grip.z_m - grip.spec.height_m / 2)


@lru_cache(maxsize=64)
def inner_extents(grips: tuple[Grip, ...]) -> tuple[float, float]:
    """How far each stick reaches from its hand towards the other one, metres: left, right."""
    left = min(rect.moved(0, 0, HAND_TURNS[0]).extent(0.0)[0] for rect in held_footprint(grips[0]))
    right = max(rect.moved(0, 0, HAND_TURNS[1]).extent(0.0)[1] for rect in held_footprint(grips[1]))
    return -left, right


def pair_heights(grips: tuple[Grip, ...], clearance_m: float) -> tuple[float, float]:
    """Heights of the two tool centre points that put each hand's lowest point ``clearance_m`` above the way's z."""
    left, right = (clearance_m - lowest_point(grip) for grip in grips)
    return left, right
