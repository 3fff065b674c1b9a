"""Tools that leave no room for a pinch are drawn and picked again, and nothing waits forever."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from evaluator.scenarios import policy_picks as picked
from evaluator.scenarios.policy_picks import Picked, Picker, draw_picked
from evaluator.sim.spawn import episode_generator
from rema_data.errors import PolicyFailureError
from rema_data.schema import Grip, Situation, StepOutcome

TASK = "grasp_grasp_push"


@pytest.fixture
def hopeless(monkeypatch: pytest.MonkeyPatch) -> set[Any]:
    """First tools, by their placement, between which nothing can be pinched."""
    bad: set[Any] = set()

    def pinch(task: str, step: int, pool: Any, some: list[Picked]) -> list[bool]:
        return [one.placements[0] not in bad for one in some]

    monkeypatch.setattr(picked, "LIMIT", 3)
    monkeypatch.setattr(picked, "_pinch", pinch)
    return bad


def always(situations: Sequence[Situation]) -> list[StepOutcome]:
    """Every pick succeeds."""
    return [StepOutcome(True, None, grip=Grip(one.target.spec, 0, 0, 0, 0, 0)) for one in situations]


def draw() -> list[Picked]:
    generators = {index: episode_generator(1, "test", TASK, index) for index in range(4)}
    no_pool: Any = None
    return draw_picked(TASK, generators, Picker("always", "digest", always), no_pool)


def test_tools_without_room_for_a_pinch_are_drawn_again(hopeless: set[Any]) -> None:
    before = draw()
    assert all(one.redrawn == 0 and len(one.grips) == 2 for one in before)
    hopeless.add(before[2].placements[0])
    after = draw()
    assert [one.placements == old.placements for one, old in zip(after, before, strict=True)] == [
        True,
        True,
        False,
        True,
    ]
    assert after[2].placements[0] not in hopeless and len(after[2].grips) == 2
    assert after[2].redrawn == 3 + len(after[2].placements)


def test_it_ends_where_no_tools_help(hopeless: set[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picked, "_pinch", lambda task, step, pool, some: [False] * len(some))
    with pytest.raises(PolicyFailureError, match="step 2 of grasp_grasp_push failed on 3 objects"):
        draw()
