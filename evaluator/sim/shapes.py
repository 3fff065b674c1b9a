"""Objects as boxes: centre of mass, inertia, footprint."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

from evaluator.sim.planar import Rect
from rema_data.schema import Grip, ObjectSpec, Placement, Shape


@lru_cache(maxsize=1024)
def boxes(spec: ObjectSpec) -> tuple[Rect, ...]:
    """Boxes of an object in its own frame (origin at the centre of mass, x along the main bar), seen from above.

    All boxes span the object's full height. The second bar of an L stands at the +x end of the main bar, that of a T
    at its middle, both towards +y. ``_BARS`` has the shapes of the suites.
    """
    if spec.shape in _BARS:
        return _centred(_BARS[spec.shape](spec))
    bar = Rect(0.0, 0.0, 0.0, spec.length_m / 2, spec.width_m / 2)
    if spec.shape is Shape.I:
        return (bar,)
    rest = spec.arm_m - spec.width_m
    x = spec.length_m / 2 - spec.width_m / 2 if spec.shape is Shape.L else 0.0
    arm = Rect(x, spec.width_m / 2 + rest / 2, 0.0, spec.width_m / 2, rest / 2)
    bar_area, arm_area = spec.length_m * spec.width_m, spec.width_m * rest
    share = arm_area / (bar_area + arm_area)
    return tuple(box._replace(x=box.x - share * arm.x, y=box.y - share * arm.y) for box in (bar, arm))


def _centred(parts: list[Rect]) -> tuple[Rect, ...]:
    """The same boxes about their common centre of mass."""
    areas = [part.half_x * part.half_y for part in parts]
    x = sum(area * part.x for area, part in zip(areas, parts, strict=True)) / sum(areas)
    y = sum(area * part.y for area, part in zip(areas, parts, strict=True)) / sum(areas)
    return tuple(part._replace(x=part.x - x, y=part.y - y) for part in parts)


def _bar(spec: ObjectSpec) -> Rect:
    return Rect(0.0, 0.0, 0.0, spec.length_m / 2, spec.width_m / 2)


def _arm(spec: ObjectSpec, place: float, side: float = 1.0, share: float = 1.0) -> Rect:
    """A bar across the main one: ``place`` along it from -1 to 1, towards +y or -y, of a share of the extent."""
    half = (share * spec.arm_m - spec.width_m) / 2
    x = place * (spec.length_m - spec.width_m) / 2
    return Rect(x, side * (spec.width_m / 2 + half), 0.0, spec.width_m / 2, half)


def _ring(spec: ObjectSpec) -> list[Rect]:
    """A square ring: two bars, and between them two sides."""
    far = spec.arm_m - spec.width_m
    sides = [_arm(spec, place, share=(spec.arm_m - spec.width_m) / spec.arm_m) for place in (-1.0, 1.0)]
    return [_bar(spec), _bar(spec)._replace(y=far), *sides]


def _star(spec: ObjectSpec) -> list[Rect]:
    """Three bars at 120 degrees from a small square; near it they overlap a little, which weighs twice."""
    out = (spec.length_m / 2 - spec.width_m / 2) / 2
    parts = [Rect(0.0, 0.0, 0.0, spec.width_m / 2, spec.width_m / 2)]
    for turn in (math.pi / 2, math.pi / 2 + 2 * math.pi / 3, math.pi / 2 + 4 * math.pi / 3):
        parts.append(Rect(spec.width_m / 2 + out, 0.0, 0.0, out, spec.width_m / 2).moved(0.0, 0.0, turn))
    return parts


_BARS: dict[Shape, Callable[[ObjectSpec], list[Rect]]] = {
    Shape.U: lambda spec: [_bar(spec), _arm(spec, -1.0), _arm(spec, 1.0)],
    Shape.Z: lambda spec: [_bar(spec), _arm(spec, 1.0), _arm(spec, -1.0, -1.0)],
    Shape.PLUS: lambda spec: [_bar(spec), _arm(spec, 0.0, share=_HALF), _arm(spec, 0.0, -1.0, share=_HALF)],
    Shape.Y: _star,
    Shape.RING: _ring,
    Shape.H: lambda spec: [
        _bar(spec),
        *(_arm(spec, place, side, share=_HALF) for place in (-1.0, 1.0) for side in (-1.0, 1.0)),
    ],
    Shape.COMB: lambda spec: [_bar(spec), *(_arm(spec, place) for place in (-1.0, 0.0, 1.0))],
    Shape.EIGHT: lambda spec: [
        *_ring(spec),
        _arm(spec, 0.0, share=(spec.arm_m - spec.width_m) / spec.arm_m),
    ],
    Shape.F: lambda spec: [_bar(spec), _arm(spec, 1.0), _arm(spec, 0.1, share=0.7)],
    Shape.HOOK: lambda spec: [
        _bar(spec),
        _arm(spec, 1.0),
        Rect(
            (spec.length_m - spec.width_m) / 2 - spec.width_m, spec.arm_m - spec.width_m, 0.0, *(spec.width_m / 2,) * 2
        ),
    ],
    Shape.RAKE: lambda spec: [
        _bar(spec),
        *(_arm(spec, 1.0, side, share=_HALF) for side in (-1.0, 1.0)),
    ],
}
"""The bars of the shapes of the suites."""
_HALF = 0.75
"""What bars on both sides of the main one reach to each side, as a share of the extent."""


def mass_kg(spec: ObjectSpec, density_kg_m3: float) -> float:
    """Mass of an object."""
    return sum(4 * box.half_x * box.half_y for box in boxes(spec)) * spec.height_m * density_kg_m3


def inertia_kg_m2(spec: ObjectSpec, density_kg_m3: float) -> tuple[float, float, float]:
    """Moments of inertia about the axes of the object's frame."""
    xx = yy = zz = 0.0
    for box in boxes(spec):
        mass = 4 * box.half_x * box.half_y * spec.height_m * density_kg_m3
        a, b, h = (2 * box.half_x) ** 2, (2 * box.half_y) ** 2, spec.height_m**2
        if box.yaw:  # seen along the axes of the object's frame
            c, s = math.cos(box.yaw) ** 2, math.sin(box.yaw) ** 2
            a, b = c * a + s * b, s * a + c * b
        xx += mass * ((b + h) / 12 + box.y**2)
        yy += mass * ((a + h) / 12 + box.x**2)
        zz += mass * ((a + b) / 12 + box.x**2 + box.y**2)
    return xx, yy, zz


def footprint(placement: Placement) -> tuple[Rect, ...]:
    """Footprint of a placed object in the world frame."""
    return tuple(box.moved(placement.x_m, placement.y_m, placement.yaw_rad) for box in boxes(placement.spec))


def held_footprint(grip: Grip) -> tuple[Rect, ...]:
    """Footprint of a held tool in the hand frame."""
    return tuple(box.moved(grip.x_m, grip.y_m, grip.yaw_rad) for box in boxes(grip.spec))
