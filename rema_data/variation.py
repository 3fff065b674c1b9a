"""What is changed in a scenario of a suite, or in a varied episode. A policy sees it by its maps and actions only.

Everything here is part of a frozen list, or of a release: an observation and an outcome are still pure functions of a
situation and an action. A clean scenario has no variation.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from rema_data.schema import ObjectSpec, Placement, Shape

if TYPE_CHECKING:
    import pydantic

__all__ = [
    "Displacement",
    "Sense",
    "Variation",
    "compact",
    "variation_from_dict",
    "variation_from_text",
    "variation_text",
]


@dataclass(frozen=True, slots=True)
class Sense:
    """A depth camera with faults, over both maps; its noise is drawn from ``seed``, once for a scenario."""

    seed: int = 0
    noise_m: float = 0.0  # standard deviation of every pixel's own error, and of an error that neighbours share
    edges: float = 0.0  # share of the pixels at edges that are lost, or float between the two heights
    block: int = 1  # pixels along each side that are averaged: a coarser camera


@dataclass(frozen=True, slots=True)
class Displacement:
    """An offset in the plane."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Variation:
    """What is other than in the clean protocol, in the last step of one scenario of a suite or of one episode.

    ``axis`` and ``level`` name its cell. ``base`` is the index of the clean scenario that it was made of; of an
    episode, its own number.
    """

    axis: str
    level: int  # from 1
    base: int
    others: tuple[Placement, ...] = ()  # further loose objects: lifting any one, alone, is a grasp
    posts: tuple[Placement, ...] = ()  # fixed objects that nothing may touch
    world: tuple[tuple[str, float], ...] = ()  # constants of the world that are others (``WorldParameters``)
    mass_offset_m: tuple[float, float] = (0.0, 0.0)  # of the target's centre of mass from that of its shape
    sense: Sense | None = None
    register: Displacement | None = None  # of the world against the maps, about the centre of the workspace
    act: Displacement | None = None  # of the hand against its goal, about the hand
    seen: str = ""  # sha256 of the maps that the last step shows, as they were when the list was frozen; of lists only

    @property
    def cell(self) -> str:
        """Axis and level, for people."""
        return f"{self.axis} {self.level}"


def variation_from_dict(row: dict[str, Any]) -> Variation:
    """Inverse of ``dataclasses.asdict``; raises TypeError, KeyError or ValueError where it is not one."""
    fields = dict(row)
    for name in ("others", "posts"):
        fields[name] = tuple(_placement(item) for item in row.get(name, ()))
    fields["world"] = tuple((str(name), float(value)) for name, value in row.get("world", ()))
    x, y = row.get("mass_offset_m", (0.0, 0.0))
    fields["mass_offset_m"] = (float(x), float(y))
    for name, kind in (("sense", Sense), ("register", Displacement), ("act", Displacement)):
        if row.get(name) is not None:
            fields[name] = kind(**row[name])
    return Variation(**fields)


def _placement(row: dict[str, Any]) -> Placement:
    spec = ObjectSpec(**{**row["spec"], "shape": Shape(row["spec"]["shape"])})
    return Placement(**{**row, "spec": spec})


def compact(variation: Variation) -> dict[str, Any]:
    """A variation as plain values, without the fields that have their default: what a list stores."""
    defaults = {item.name: item.default for item in dataclasses.fields(Variation)}
    return {name: value for name, value in dataclasses.asdict(variation).items() if value != defaults.get(name)}


def variation_text(variation: Variation) -> str:
    """A variation as JSON, the same text for the same variation: what a release stores."""
    return json.dumps(compact(variation), separators=(",", ":"))


def variation_from_text(text: str) -> Variation:
    """Inverse of ``variation_text``; raises ValueError for any other text."""
    found = _checked().validate_json(text)
    if variation_text(found) != text:
        raise ValueError("it is not written as it would be stored")
    return found


@cache
def _checked() -> pydantic.TypeAdapter[Variation]:
    import pydantic  # reading clean data does without it

    return pydantic.TypeAdapter(Variation)
