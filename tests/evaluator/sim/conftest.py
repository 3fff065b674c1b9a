"""A simulator for the tests of the world, and situations to put into it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from evaluator.sim.parameters import WORLD
from evaluator.sim.simulator import Simulator
from rema_data.schema import Grip, ObjectSpec, Shape

HEIGHT = WORLD.object_height_m
BAR = ObjectSpec(Shape.I, 0.10, 0.03, 0.0, HEIGHT)
TEE = ObjectSpec(Shape.T, 0.11, 0.03, 0.095, HEIGHT)
ELL = ObjectSpec(Shape.L, 0.12, 0.025, 0.10, HEIGHT)
STICK = ObjectSpec(Shape.I, 0.19, 0.025, 0.0, HEIGHT)


def held(spec: ObjectSpec, along_m: float = 0.0, yaw_rad: float = 1.5707963) -> Grip:
    """A bar held across near its middle, as a grasp at the protocol's height leaves it."""
    return Grip(spec, 0.0, along_m, HEIGHT / 2 - WORLD.grasp_height_m, yaw_rad, spec.width_m)


@pytest.fixture(scope="session")
def simulator() -> Iterator[Simulator]:
    made = Simulator()
    yield made
    made.close()
