"""What an axis is."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rema_data.schema import TASKS, Placement, Scenario
from rema_data.variation import Variation

if TYPE_CHECKING:  # a board shows the axes without PyBullet
    from evaluator.sim.simulator import Simulator

__all__ = ["Axis", "Draw", "varied", "with_target"]


@dataclass(frozen=True, slots=True)
class Draw:
    """What an axis draws with.

    Without a ``simulator``, nobody picks the tools of a scenario: they get into the hands by its own first steps.
    """

    rng: np.random.Generator
    simulator: Simulator | None = None


class Axis(ABC):
    """One thing that a suite changes.

    ``number`` keys what is drawn, and says which clean scenarios the axis is made of; it never changes.
    """

    name: ClassVar[str]
    number: ClassVar[int]
    title: ClassVar[str]  # what changes, for people
    levels: ClassVar[tuple[str, ...]]  # what each level is, for people: the first one changes least
    tasks: ClassVar[tuple[str, ...]] = tuple(TASKS)
    counts: ClassVar[bool] = True  # whether its mean counts in ``hard``
    # whether only what is seen, or where the hand goes, is not what is there: the clean scenario's solution then holds
    noisy: ClassVar[bool] = False

    left_out: ClassVar[Mapping[str, tuple[int, ...]]] = {}  # levels that are not played in a task, by task

    def levels_in(self, task: str) -> list[int]:
        """The levels that are played in a task, from 1; none where the task does not have the axis."""
        if task not in self.tasks:
            return []
        return [level for level in range(1, len(self.levels) + 1) if level not in self.left_out.get(task, ())]

    @abstractmethod
    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario | None:
        """A scenario at a level, from 1; None where this draw makes none, and another one has to be tried."""


def varied(scenario: Scenario, **changes: Any) -> Scenario:
    """A scenario whose variation has other fields."""
    variation = scenario.variation or Variation("", 0, scenario.index)
    if "world" in changes:
        changes["world"] = tuple(sorted((dict(variation.world) | dict(changes["world"])).items()))
    return dataclasses.replace(scenario, variation=dataclasses.replace(variation, **changes))


def with_target(scenario: Scenario, target: Placement) -> Scenario:
    """A scenario whose last step has another object."""
    return dataclasses.replace(scenario, placements=(*scenario.placements[:-1], target))
