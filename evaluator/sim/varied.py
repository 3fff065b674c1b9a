"""Scenarios of suites: the world, the place of an action and its target, as a variation makes them.

Everything is the identity where a situation has no variation. ``evaluator.sim.sense`` changes what is seen.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from functools import lru_cache

from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.planar import Rect, gap
from evaluator.sim.shapes import footprint
from evaluator.sim.staging import Pose, turned
from rema_data.schema import Placement, Situation

__all__ = ["aimed_at", "executed", "parameters_of", "standing"]


def parameters_of(situation: Situation, p: WorldParameters = WORLD) -> WorldParameters:
    """The constants of the world of a situation."""
    return p if situation.variation is None else _replaced(p, situation.variation.world)


@lru_cache(maxsize=256)
def _replaced(p: WorldParameters, changes: tuple[tuple[str, float], ...]) -> WorldParameters:
    return dataclasses.replace(p, **dict(changes)) if changes else p  # type: ignore[arg-type]


def executed(situation: Situation, pose: Pose) -> Pose:
    """Where the hand really goes: the map is displaced against the world, and the hand against its goal."""
    variation = situation.variation
    if variation is None:
        return pose
    x, y, yaw = pose
    if (error := variation.register) is not None:
        x, y = turned((error.x_m, error.y_m, error.yaw_rad), x, y)
        yaw += error.yaw_rad
    if (error := variation.act) is not None:
        x, y, yaw = x + error.x_m, y + error.y_m, yaw + error.yaw_rad
    return x, y, yaw


def aimed_at(situation: Situation, pose: Pose, p: WorldParameters) -> Situation:
    """With loose objects beside the target, any of them may be lifted: the one between the fingers is the target."""
    variation = situation.variation
    if variation is None or not variation.others:
        return situation
    jaws = Rect(0.0, 0.0, 0.0, p.opening_max_m / 2, p.finger_lateral_m / 2).moved(*pose)
    loose = (situation.target, *variation.others)
    nearest = min(range(len(loose)), key=lambda n: (_distance(jaws, loose[n]), n))
    others = tuple(one for n, one in enumerate(loose) if n != nearest)
    return dataclasses.replace(
        situation, target=loose[nearest], variation=dataclasses.replace(variation, others=others)
    )


def _distance(jaws: Rect, placement: Placement) -> float:
    """Gap between jaws and an object; among those that they overlap, the one whose centre is nearest to theirs."""
    apart = gap([jaws], footprint(placement))
    return apart if apart > 0 else math.dist((jaws.x, jaws.y), (placement.x_m, placement.y_m)) - 1.0


def standing(situation: Situation) -> Iterator[Placement]:
    """Everything that stands on the table: the target first, then other loose objects, then posts."""
    yield situation.target
    if situation.variation is not None:
        yield from situation.variation.others
        yield from situation.variation.posts
