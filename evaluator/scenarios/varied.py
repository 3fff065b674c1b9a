"""Varied episodes for training: a clean one, or one with something changed in its last step, from its own generator.

The axes and levels are those of the suites (``axes``), the scenes are not: they come from the generator of a collected
episode. Nobody looks whether an episode can be solved.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evaluator.scenarios.axes import AXES, Draw
from rema_data.schema import Scenario
from rema_data.variation import Variation

__all__ = ["CLEAN", "VARIES", "Vary", "axes_in", "vary_episode"]

CLEAN = 0.5
"""Share of the clean episodes, where a plan does not say another one."""
VARIES = ("evaluator.scenarios.axes", "evaluator.scenarios.varied")
"""Packages and modules whose code, with that of the world (``evaluator.sim.DECIDES``), decides a varied episode."""
_TRIES = 50


class Vary(NamedTuple):
    """How episodes are varied: by one of some axes, or not at all, with the probability ``clean``."""

    axes: tuple[str, ...]
    clean: float = CLEAN


def axes_in(task: str, axes: Sequence[str]) -> tuple[str, ...]:
    """Those of some axes that a task has."""
    return tuple(name for name in axes if AXES[name].levels_in(task))


def vary_episode(clean: Scenario, vary: Vary, rng: np.random.Generator) -> Scenario:
    """An episode as it is, or at one level of one axis that its task has: axes, and levels of an axis, equally often.

    What an axis cannot make of a scenario is tried again with what the generator gives next; after 50 times the episode
    stays clean. Tools are not picked: the first steps of the episode do that.
    """
    axes = axes_in(clean.task, vary.axes)
    if not axes or rng.random() < vary.clean:
        return clean
    axis = AXES[axes[int(rng.integers(len(axes)))]]
    levels = axis.levels_in(clean.task)
    level = levels[int(rng.integers(len(levels)))]
    for _ in range(_TRIES):
        made = axis.vary(clean, level, Draw(rng))
        if made is not None:
            known = made.variation or Variation("", 0, clean.index)
            return dataclasses.replace(made, variation=dataclasses.replace(known, axis=axis.name, level=level))
    return clean
