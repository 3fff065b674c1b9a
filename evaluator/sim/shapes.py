"""I, L and T as boxes: centre of mass, inertia, footprint."""

from __future__ import annotations

from functools import lru_cache

from evaluator.sim.planar import Rect
from rema_data.schema import Grip, ObjectSpec, Placement, Shape


@lru_cache(maxsize=1024)
def boxes(spec: ObjectSpec) -> tuple[Rect, ...]:
    """Boxes of an object in its own frame (origin at the centre of mass, x along the main bar), seen from above.

    All boxes span the object's full height. The second bar of an L stands at the +x end of the main bar, that of a T
    at its middle, both towards +y.
    """
    bar = Rect(0.0, 0.0, 0.0, spec.length_m / 2, spec.width_m / 2)
    if spec.shape is Shape.I:
        return (bar,)
    rest = spec.arm_m - spec.width_m
    x = spec.length_m / 2 - spec.width_m / 2 if spec.shape is Shape.L else 0.0
    arm = Rect(x, spec.width_m / 2 + rest / 2, 0.0, spec.width_m / 2, rest / 2)
    bar_area, arm_area = spec.length_m * spec.width_m, spec.width_m * rest
    share = arm_area / (bar_area + arm_area)
    return tuple(box._replace(x=box.x - share * arm.x, y=box.y - share * arm.y) for box in (bar, arm))


def mass_kg(spec: ObjectSpec, density_kg_m3: float) -> float:
    """Mass of an object."""
    return sum(4 * box.half_x * box.half_y for box in boxes(spec)) * spec.height_m * density_kg_m3


def inertia_kg_m2(spec: ObjectSpec, density_kg_m3: float) -> tuple[float, float, float]:
    """Moments of inertia about the axes of the object's frame."""
    xx = yy = zz = 0.0
    for box in boxes(spec):
        mass = 4 * box.half_x * box.half_y * spec.height_m * density_kg_m3
        a, b, h = (2 * box.half_x) ** 2, (2 * box.half_y) ** 2, spec.height_m**2
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
