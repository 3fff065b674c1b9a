"""Height maps from worse cameras."""

from __future__ import annotations

import dataclasses

from evaluator.scenarios.axes.base import Axis, Draw, varied
from rema_data.schema import Scenario
from rema_data.variation import Sense

__all__ = ["Resolution", "SenseNoise"]


class SenseNoise(Axis):
    """Depth noise on both maps."""

    name, number = "sense", 5
    title = "depth noise on both maps: standard deviation, and the share of edge pixels that are lost or fly"
    _levels = ((0.001, 0.10), (0.0025, 0.50), (0.005, 0.75))
    levels = tuple(f"{1000 * noise:g} mm, {100 * edges:.0f} % of the edges" for noise, edges in _levels)
    noisy = True

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        noise, edges = self._levels[level - 1]
        seed = int(draw.rng.integers(2**62))
        return varied(scenario, sense=dataclasses.replace(_sense(scenario), seed=seed, noise_m=noise, edges=edges))


class Resolution(Axis):
    """Both maps averaged over blocks of pixels."""

    name, number = "resolution", 6
    title = "both maps averaged over blocks of pixels"
    _blocks = (2, 3, 4)
    levels = tuple(f"{block} x {block} pixels" for block in _blocks)
    noisy = True

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        return varied(scenario, sense=dataclasses.replace(_sense(scenario), block=self._blocks[level - 1]))


def _sense(scenario: Scenario) -> Sense:
    known = None if scenario.variation is None else scenario.variation.sense
    return known or Sense()
