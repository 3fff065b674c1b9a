"""Footprints of hands, held tools and pairs of them, seen from above: pure geometry shared by primitives and maps."""

from __future__ import annotations

import math
from collections.abc import Sequence

from evaluator.sim.parameters import WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import boxes, footprint, held_footprint
from rema_data.schema import Grip, Pinch, Situation

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
    """Whether footprints, moved to a world pose (x, y, yaw), keep ``margin_m`` away from the target."""
    return gap((rect.moved(*pose) for rect in footprints), footprint(situation.target)) > margin_m


def lowest_point(grip: Grip | None) -> float:
    """Height of the lowest point of fingers and held tool above the tool centre point (0 or negative)."""
    return 0.0 if grip is None else min(0.0, grip.z_m - grip.spec.height_m / 2)


def inner_extents(grips: tuple[Grip, ...]) -> tuple[float, float]:
    """How far each stick reaches from its hand towards the other one, metres: left, right."""
    left = min(rect.moved(0, 0, HAND_TURNS[0]).extent(0.0)[0] for rect in held_footprint(grips[0]))
    right = max(rect.moved(0, 0, HAND_TURNS[1]).extent(0.0)[1] for rect in held_footprint(grips[1]))
    return -left, right


def hand_footprints(grips: tuple[Grip, ...], distances: tuple[float, float], p: WorldParameters) -> list[list[Rect]]:
    """Footprints in the pair frame: fingers and stick of the left hand, then of the right hand."""
    result = []
    for grip, distance, side, turn in zip(grips, distances, SIDES, HAND_TURNS, strict=True):
        parts = (*finger_footprint(grip.opening_m, p), *held_footprint(grip))
        result.append([rect.moved(side * distance, 0.0, turn) for rect in parts])
    return result


def pair_heights(grips: tuple[Grip, ...], clearance_m: float) -> tuple[float, float]:
    """Heights of the two tool centre points that put each hand's lowest point ``clearance_m`` above the way's z."""
    left, right = (clearance_m - lowest_point(grip) for grip in grips)
    return left, right


def pinched_footprint(grips: tuple[Grip, ...], pinch: Pinch, parameters: WorldParameters) -> tuple[Rect, ...]:
    """Footprint in the pair frame of everything that moves in a push with a pinched object."""
    hands = hand_footprints(grips, (pinch.left_m, pinch.right_m), parameters)
    held = (box.moved(pinch.x_m, pinch.y_m, pinch.yaw_rad) for box in boxes(pinch.spec))
    return (*hands[0], *hands[1], *held)


def pinched_heights(grips: tuple[Grip, ...], pinch: Pinch, p: WorldParameters) -> tuple[float, float]:
    """Heights of both tool centre points above the table while a pinched object pushes.

    The hands keep the heights they pinched at; the whole is lowered until its lowest point is at the clearance.
    """
    heights = pair_heights(grips, p.pair_clearance_m)
    bottom = min(min(heights) + pinch.z_m - pinch.spec.height_m / 2, p.pair_clearance_m)
    shift = p.pinched_clearance_m - bottom
    return heights[0] + shift, heights[1] + shift
