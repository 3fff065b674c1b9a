"""Varied episodes: one axis and one level of the suites, or none, as a function of the episode's own generator."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from evaluator.scenarios.axes import AXES
from evaluator.scenarios.axes.base import Axis, Draw
from evaluator.scenarios.varied import Vary, vary_episode
from evaluator.sim.observation import observe
from evaluator.sim.spawn import draw_episode
from rema_data.schema import TASKS, Scenario
from rema_data.variation import variation_from_text, variation_text

ALL = tuple(AXES)


def clean(task: str, index: int) -> tuple[Scenario, np.random.Generator]:
    rng = np.random.default_rng(index)
    return Scenario(task, "train", index, draw_episode(rng, task)), rng


def drawn(task: str, vary: Vary, count: int) -> list[Scenario]:
    return [vary_episode(*(scenario, vary, rng)) for scenario, rng in (clean(task, n) for n in range(count))]


@pytest.mark.parametrize("task", TASKS)
def test_an_episode_is_clean_or_of_one_cell_that_its_task_has(task: str) -> None:
    cells = Counter()
    for index, made in enumerate(drawn(task, Vary(ALL), 400)):
        before, _ = clean(task, index)
        if made.variation is None:
            assert made == before
            continue
        axis = AXES[made.variation.axis]
        assert made.variation.level in axis.levels_in(task) and made.variation.base == index
        assert variation_from_text(variation_text(made.variation)) == made.variation
        assert (made.grips, made.pinch) == ((), None)  # the first steps of the episode make these
        changed = [n for n, (a, b) in enumerate(zip(before.placements, made.placements, strict=True)) if a != b]
        tools = axis.name in ("tool", "mixed")
        assert tools or all(n == len(TASKS[task]) - 1 for n in changed)
        cells[axis.name] += 1
    assert set(cells) == {name for name, axis in AXES.items() if axis.levels_in(task)}
    assert 0.4 < cells.total() / 400 < 0.6


def test_the_share_of_clean_episodes_is_given() -> None:
    few = sum(one.variation is None for one in drawn("push", Vary(("sense",), 0.1), 300))
    assert 10 <= few <= 60
    assert all(one.variation is not None for one in drawn("push", Vary(("sense",), 0.0), 20))


def test_the_same_generator_makes_the_same_episode() -> None:
    assert drawn("grasp", Vary(ALL), 40) == drawn("grasp", Vary(ALL), 40)


def test_a_task_without_an_axis_stays_as_it_is() -> None:
    scenario, rng = clean("push", 3)
    state = rng.bit_generator.state
    assert vary_episode(scenario, Vary(("clutter", "hand"), 0.0), rng) == scenario
    assert rng.bit_generator.state == state


def test_what_an_axis_cannot_make_is_tried_again_and_then_left(monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[int] = []

    class Picky(Axis):
        name, number, title, levels = "picky", 99, "", ("one",)

        def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario | None:
            assert draw.simulator is None
            tries.append(int(draw.rng.integers(100)))
            return scenario if len(tries) % 60 == 3 else None

    monkeypatch.setitem(AXES, "picky", Picky())
    scenario, rng = clean("grasp", 0)
    made = vary_episode(scenario, Vary(("picky",), 0.0), rng)
    assert len(tries) == 3 and len(set(tries)) > 1
    assert made.variation is not None and (made.variation.axis, made.variation.level) == ("picky", 1)
    assert vary_episode(scenario, Vary(("picky",), 0.0), rng) == scenario and len(tries) == 53


def test_only_the_last_step_is_varied() -> None:
    made = next(one for one in drawn("grasp_push", Vary(("sense",), 0.0), 1))
    assert made.first_situation().variation is None
    first = observe(made.first_situation())
    assert np.array_equal(first.scene, observe(dataclasses.replace(made, variation=None).first_situation()).scene)
    alone = next(one for one in drawn("push", Vary(("sense",), 0.0), 1))
    assert alone.first_situation() == alone.last_situation()
    assert alone.first_situation().variation == alone.variation
