"""The random, the scripted and the reference policy, and the example of the README."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chisquare

from baselines.random_policy import RandomPolicy
from baselines.reference_policy import ReferencePolicy
from baselines.scripted_policy import ScriptedPolicy, nearest_valid
from evaluator.policy.contract import ObservationBatch, Policy, PrivilegedPolicy
from evaluator.policy.faults import check_answer
from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import valid_actions
from evaluator.sim.simulator import Simulator
from evaluator.sim.spawn import collection_generator, draw_step
from evaluator.testing.policies import PolicyContract
from rema_data import grid
from rema_data.schema import Shape, Situation
from tests.evaluator.policy.batches import make_batch, make_situation

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_policy.py"


class TestScripted(PolicyContract):
    policy = "scripted"


class TestReference(PolicyContract):
    policy = "reference"


class TestLearned(PolicyContract):
    policy = "tae-joint"
    task = "grasp"


class TestExample(PolicyContract):
    policy = EXAMPLE


def example() -> Any:
    spec = importlib.util.spec_from_file_location("example_policy", EXAMPLE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Policy(None, "cpu")


def with_valid(batch: ObservationBatch, valid: np.ndarray) -> ObservationBatch:
    return ObservationBatch(batch.scene, batch.end_effector, batch.primitive, batch.embodiment, batch.task, 0, valid)


def test_they_keep_the_contract() -> None:
    assert isinstance(RandomPolicy(), Policy)
    assert isinstance(ScriptedPolicy(), PrivilegedPolicy) and ScriptedPolicy.privileged
    assert isinstance(ReferencePolicy(), PrivilegedPolicy) and ReferencePolicy.privileged
    assert not hasattr(RandomPolicy, "privileged")


def test_random_does_not_depend_on_batch_or_order() -> None:
    batch = make_batch(12)
    whole = RandomPolicy().act(batch)
    assert len(set(whole.tolist())) > 8
    assert [int(RandomPolicy().act(batch.one(n))[0]) for n in reversed(range(12))] == whole[::-1].tolist()


def test_random_is_uniform_over_the_valid_grid() -> None:
    batch = make_batch(600)
    valid = np.zeros_like(batch.valid)
    cells = [(10, 11, 3), (40, 20, 0), (59, 4, 15), (30, 30, 7)]
    for cell in cells:
        valid[(slice(None), *cell)] = True
    drawn = RandomPolicy().act(with_valid(batch, valid)).tolist()
    counts = [drawn.count(int(grid.encode(*cell))) for cell in cells]
    assert sum(counts) == 600
    assert chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize(("task", "offset_m"), [("grasp", 0.0), ("push", WORLD.scripted_push_offset_m)])
def test_scripted_goes_to_the_target(task: str, offset_m: float) -> None:
    batch = make_batch(40, task)
    generator = np.random.default_rng(1)
    places = [tuple(float(part) for part in generator.uniform(-0.02, 0.1, 2)) for _ in range(40)]
    actions = ScriptedPolicy().act(batch, tuple(make_situation(x_m, y_m, task) for x_m, y_m in places))
    x_m, y_m, _ = grid.to_world(actions)
    assert np.abs(x_m - [place[0] - offset_m for place in places]).max() <= grid.PIXEL_M / 2 + 1e-12
    assert np.abs(y_m - [place[1] for place in places]).max() <= grid.PIXEL_M / 2 + 1e-12
    assert len(set((actions % grid.ANGLES).tolist())) > 8


def test_scripted_angles_of_two_arms_are_halved() -> None:
    batch = make_batch(40)
    batch.valid[..., 8:] = False
    actions = ScriptedPolicy().act(batch, (make_situation(),) * 40)
    assert set((actions % grid.ANGLES).tolist()) == set(range(8))


def situations_of(task: str, step: int, count: int) -> tuple[Situation, ...]:
    """Fresh objects for a step before the last, with the tools of frozen scenarios in hand."""
    found = []
    for scenario in load_list(task, "val").scenarios[:count]:
        placement = draw_step(collection_generator(3, 1, task, "train", scenario.index), task, step)
        found.append(Situation(task, step, placement, scenario.grips[:step]))
    return tuple(found)


def batch_of(situations: tuple[Situation, ...]) -> ObservationBatch:
    """What a policy is shown of them."""
    first, seen = situations[0], [observe(situation) for situation in situations]
    valid = valid_actions(first.task, first.step)
    return ObservationBatch(
        np.stack([one.scene_m() for one in seen]),
        np.stack([one.end_effector() for one in seen]),
        first.kind.primitive.value,
        first.kind.embodiment.value,
        first.task,
        first.step,
        np.broadcast_to(valid, (len(seen), *valid.shape)),
    )


@pytest.mark.parametrize(("task", "step"), [("grasp_push", 0), ("grasp_grasp", 1), ("grasp_grasp_push", 2)])
def test_the_reference_picks_nearly_everything_up(task: str, step: int) -> None:
    """Also what the scripted policy mostly misses: an L or a T between two sticks."""
    situations = tuple(
        situation for situation in situations_of(task, step, 14) if step < 2 or situation.target.spec.shape != Shape.I
    )
    batch = batch_of(situations)
    picked = {}
    simulator = Simulator()
    for policy in (ReferencePolicy(), ScriptedPolicy()):
        answers = check_answer(policy.act(batch, situations), batch.valid)
        outcomes = [simulator.run(situation, int(a)) for situation, a in zip(situations, answers, strict=True)]  # type: ignore[call-overload]
        picked[type(policy)] = sum(outcome.success for outcome in outcomes)
    simulator.close()
    assert picked[ReferencePolicy] >= 0.7 * len(situations)
    assert picked[ReferencePolicy] > picked[ScriptedPolicy]


def test_the_reference_does_not_depend_on_batch_or_order() -> None:
    for task, step in (("grasp_push", 0), ("grasp_grasp_push", 2)):
        situations = situations_of(task, step, 6)
        batch = batch_of(situations)
        whole = ReferencePolicy().act(batch, situations).tolist()
        alone = [int(ReferencePolicy().act(batch.one(n), (situations[n],))[0]) for n in reversed(range(6))]
        assert alone == whole[::-1]


def test_the_reference_falls_back_to_the_scripted_policy() -> None:
    batch = make_batch(8, primitive="push")
    situations = (make_situation(task="push"),) * 8
    assert ReferencePolicy().act(batch, situations).tolist() == ScriptedPolicy().act(batch, situations).tolist()
    batch = make_batch(8)
    batch.valid[:, :, 20:] = False  # its picks are out of reach
    outside = (make_situation(x_m=0.05),) * 8
    answers = ReferencePolicy().act(batch, outside)
    assert answers.tolist() == ScriptedPolicy().act(batch, outside).tolist()
    assert all(isinstance(answer, int) for answer in check_answer(answers, batch.valid))


def test_the_nearest_valid_pixel_keeps_the_angle() -> None:
    valid = np.zeros((64, 64, 16), bool)
    valid[30, 30, 5] = valid[20, 24, 5] = valid[20, 16, 5] = valid[24, 20, 5] = valid[20, 20, 6] = True
    assert nearest_valid(valid, 30, 30, 5) == (30, 30, 5)
    assert nearest_valid(valid, 20, 20, 5) == (20, 16, 5)  # three at the same distance: the lowest index
    assert nearest_valid(valid, 29, 33, 5) == (30, 30, 5)


@pytest.mark.parametrize("primitive", ["grasp", "push"])
def test_the_example_always_answers_a_valid_action(primitive: str) -> None:
    batch = make_batch(20, primitive=primitive)
    batch.valid[:, 20:30, :, 3:9] = False
    answers = check_answer(np.asarray(example().act(batch)), batch.valid)
    assert all(isinstance(answer, int) for answer in answers)


def test_the_example_grasps_across_the_bar_and_pushes_from_behind() -> None:
    batch = make_batch(1)
    rows, columns = np.nonzero(batch.scene[0] > 0.005)  # a bar along x: the jaws must close along y
    i, j, k = example().act(batch)[0]
    assert abs(i - rows.mean()) <= 0.5 and abs(j - columns.mean()) <= 0.5 and k % 8 == 4
    push = make_batch(1, primitive="push", seed=3)
    j = example().act(push)[0][1]
    assert j < np.nonzero(push.scene[0] > 0.005)[1].min() or j == grid.VALID_MARGIN


def test_the_example_points_a_tool_ahead() -> None:
    batch = make_batch(1, primitive="push")
    batch.end_effector[:] = 0
    batch.end_effector[:, 60:80, 55:57, 1] = 1  # a bar from the hand along +y: a quarter turn back points it along +x
    i, _, k = example().act(batch)[0]
    rows, _ = np.nonzero(batch.scene[0] > 0.005)
    assert k == 12 and abs(i - rows.mean()) <= 1.5


@pytest.mark.parametrize("pixels", [[], [(30, 30)], [(30, 30), (30, 31)]])
def test_the_example_copes_with_odd_scenes(pixels: list[tuple[int, int]]) -> None:
    batch = make_batch(1)
    batch.scene[:] = 0
    for pixel in pixels:
        batch.scene[(0, *pixel)] = 0.03
    assert isinstance(check_answer(np.asarray(example().act(batch)), batch.valid)[0], int)
