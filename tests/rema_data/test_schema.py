"""Records: what an action, a step and an episode say about themselves."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rema_data import grid
from rema_data.schema import (
    TASKS,
    Action,
    Embodiment,
    Episode,
    Failure,
    Primitive,
    StepKind,
    StepOutcome,
    outcome_from_dict,
    skill,
    to_dict,
)
from rema_data.store.block import BlockKey
from rema_data.testing import synthetic_episode


@given(st.integers(0, grid.ACTIONS - 1))
def test_an_action_is_its_cell_and_its_pose(index: int) -> None:
    action = Action(index)
    assert grid.encode(*action.cell) == index
    assert grid.snap(*action.pose) == index or not grid.inside_valid_square()[action.cell[:2]]


def test_every_step_exercises_the_skill_of_a_task() -> None:
    assert [skill(kind) for kind in TASKS["grasp_grasp_push"]] == ["grasp", "grasp", "grasp_grasp", "grasp_grasp_push"]
    assert skill(StepKind(Primitive.PUSH, Embodiment.TOOL)) == "grasp_push"


@pytest.mark.parametrize("task", TASKS)
def test_an_episode_succeeds_only_at_its_last_step(task: str) -> None:
    for index in range(60):
        episode = synthetic_episode(BlockKey(1, task, "train"), index)
        assert all(step.outcome.success for step in episode.steps[:-1])
        reached = len(episode.steps) == len(TASKS[task])
        assert episode.success == (reached and episode.steps[-1].outcome.success)
        assert (episode.failure is None) == episode.success
    assert not Episode(task, 1, "train", 0, 0, episode.steps[:1]).success or len(TASKS[task]) == 1


def test_an_outcome_survives_json() -> None:
    outcome = StepOutcome(False, Failure.SLIPPED, arm="left", displacement_m=0.01, lift_m=0.2, contact_steps=4)
    assert outcome_from_dict(to_dict(outcome)) == outcome
    assert dataclasses.asdict(outcome) == to_dict(outcome)
