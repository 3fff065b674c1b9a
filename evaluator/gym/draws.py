"""The scenario of an episode: a new one from the training domain, or a frozen one of a list."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache, cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from evaluator.rollout.episode import frozen_scenario
from evaluator.run.plan import Plan
from evaluator.scenarios import SPLITS, ScenarioList, load_list, scenario_id
from evaluator.sim.reference import prepare
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import collection_generator, draw_episode
from rema_data.errors import InputError
from rema_data.schema import TASKS, Scenario

__all__ = ["DOMAINS", "Draws", "Start"]

TRAIN = "train"
DOMAINS = (TRAIN, *SPLITS)
"""Where scenarios come from: drawn now, or one of the frozen lists."""
_NAME = re.compile(r"(?P<version>[^/]+)/(?P<task>[^/]+)/(?P<split>[^/]+)/(?P<index>\d+)")
_COLLECTED = re.compile(
    r"collected/(?P<seed>\d{1,20})/round-(?P<round>\d{1,5})/(?P<task>[^/]+)/(?P<split>train|val)/(?P<episode>\d{1,10})"
)


class Start(NamedTuple):
    """A scenario and its name, which is empty where it was drawn now."""

    name: str
    scenario: Scenario


class Draws:
    """Scenarios of a task: drawn from a domain, or chosen by name.

    The domain ``train`` is endless and shares nothing with the frozen lists: objects come from the generator of the
    episode, and where only the last step is played, tools as the reference policy picks them. From the frozen lists,
    ``test`` and ``val``, scenarios are drawn with replacement.
    """

    def __init__(self, task: str, domain: str, protocol: str) -> None:
        if domain not in DOMAINS:
            raise InputError(f"unknown domain {domain!r}", hint=f"choose one of: {', '.join(DOMAINS)}", domain=domain)
        self._task, self._domain, self._protocol = task, domain, protocol
        self._plan = Plan((), task, protocol)
        self._list: Callable[[str, str | None], ScenarioList] = cache(partial(load_list, task))

    def draw(self, rng: np.random.Generator, simulator: Simulator) -> Start:
        """A scenario of the domain; the simulator picks the tools of a new one."""
        if self._domain != TRAIN:
            return self._frozen(self._domain, int(rng.choice(self.playable)))
        if self._plan.end_to_end:
            return Start("", Scenario(self._task, TRAIN, 0, draw_episode(rng, self._task)))
        return Start("", prepare(simulator, self._task, rng).scenario(self._task, TRAIN))

    def named(self, name: Any) -> Start:
        """The scenario of a name; raises InputError where there is no such, or it cannot be played.

        ``name`` is a position in the list of the domain (of ``val`` where the domain is ``train``), the name of a
        frozen scenario such as ``v1/grasp/test/00042``, or that of a collected episode (root seed, block, episode) such
        as ``collected/0/round-1/grasp/train/17``. An episode that is varied there is clean here.
        """
        if not isinstance(name, str):
            return self._frozen("val" if self._domain == TRAIN else self._domain, int(name))
        if (collected := _COLLECTED.fullmatch(name)) is not None and collected["task"] == self._task:
            return self._collected(name, collected)
        match = _NAME.fullmatch(name)
        if match is None or match["task"] != self._task:
            raise InputError(
                f"{name!r} is not a scenario of {self._task}",
                hint=f"name one like {scenario_id('v1', Scenario(self._task, 'val', 42, ()))}",
                scenario=name,
            )
        return self._frozen(match["split"], int(match["index"]), match["version"])

    def _collected(self, name: str, parts: re.Match[str]) -> Start:
        """The objects of a collected episode, drawn again, as if it were clean. Its own first steps pick the tools."""
        if len(TASKS[self._task]) > 1 and not self._plan.end_to_end:
            raise InputError(
                f"{name} begins with empty hands, and the conditional protocol with tools in hand",
                hint='make the environment with protocol="end-to-end"',
                scenario=name,
            )
        seed, round_, episode = (int(parts[key]) for key in ("seed", "round", "episode"))
        rng = collection_generator(seed, round_, self._task, parts["split"], episode)
        return Start(name, Scenario(self._task, parts["split"], episode, draw_episode(rng, self._task)))

    @cached_property
    def playable(self) -> list[int]:
        """Positions in the list of the domain that the protocol can be played on."""
        scenarios = self._list(self._domain, None).scenarios
        return [scenario.index for scenario in scenarios if self._plan.eligible(scenario)]

    def _frozen(self, split: str, index: int, version: str | None = None) -> Start:
        found = self._list(split, version)
        scenario = frozen_scenario(found, index, self._protocol)
        return Start(scenario_id(found.version, scenario), scenario)
