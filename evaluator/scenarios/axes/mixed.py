"""All axes at once."""

from __future__ import annotations

from collections.abc import Sequence

from evaluator.scenarios.axes.base import Axis, Draw
from rema_data.schema import Scenario

__all__ = ["Mixed"]


class Mixed(Axis):
    """Every axis of the task at its first level."""

    name, number = "mixed", 10
    title = "every axis of the task at its first level"
    levels = ("all first levels",)
    counts = False
    noisy = False  # what is seen is not what is there, but together the axes can also leave nothing that succeeds

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario | None:
        made: Scenario | None = scenario
        for axis in self._axes:
            if made is not None and (played := axis.levels_in(scenario.task)):
                made = axis.vary(made, played[0], draw)
        return made
