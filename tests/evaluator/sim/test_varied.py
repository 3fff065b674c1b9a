"""Scenarios of suites in the world: what changes, and that nothing changes without a variation."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.scenarios import load_list
from evaluator.sim.observation import observe
from evaluator.sim.parameters import WORLD, parameters_hash
from evaluator.sim.sense import sensed
from evaluator.sim.simulator import Simulator
from evaluator.sim.varied import aimed_at, executed, parameters_of
from rema_data import grid
from rema_data.schema import Failure, ObjectSpec, Placement, Shape, Situation
from rema_data.variation import Displacement, Sense, Variation, compact, variation_from_dict

BAR = Placement(ObjectSpec(Shape.I, 0.10, 0.03, 0.0, 0.03), 0.0, 0.0, 0.0)
ACROSS = int(grid.snap(0.0, 0.0, np.pi / 2))
"""A grasp across the bar."""


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator()


def grasp(**changes: object) -> Situation:
    return Situation("grasp", 0, BAR, variation=Variation("x", 1, 0, **changes))  # type: ignore[arg-type]


variations = st.builds(
    Variation,
    st.sampled_from(["shape", "act"]),
    st.integers(1, 5),
    st.integers(0, 9999),
    others=st.lists(st.just(BAR), max_size=2).map(tuple),
    posts=st.lists(st.just(BAR), max_size=2).map(tuple),
    world=st.sampled_from([(), (("density_kg_m3", 1000.0),)]),
    mass_offset_m=st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
    sense=st.none() | st.builds(Sense, st.integers(0, 2**62), st.floats(0, 0.01), st.floats(0, 1), st.integers(1, 4)),
    register=st.none() | st.builds(Displacement, st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-0.2, 0.2)),
    act=st.none() | st.builds(Displacement, st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-0.2, 0.2)),
)


@given(variations)
def test_a_variation_survives_its_text(variation: Variation) -> None:
    assert variation_from_dict(json.loads(json.dumps(compact(variation)))) == variation


def test_the_clean_protocol_is_untouched() -> None:
    """The constants of the world, and lists v2, are those that every entry of the board was made with."""
    assert parameters_hash() == "beadb034c9753cded5c00eb9b998655957e7abf0df2c66e1dbffd0458b6b1542"
    for scenario in load_list("grasp").scenarios[:50]:
        situation = scenario.last_situation()
        assert situation.variation is None and parameters_of(situation) is WORLD
        assert executed(situation, (0.1, 0.2, 0.3)) == (0.1, 0.2, 0.3)
        assert aimed_at(situation, (0.1, 0.2, 0.3), WORLD) is situation


def test_a_variation_that_changes_nothing_changes_nothing(simulator: Simulator) -> None:
    clean = Situation("grasp", 0, BAR)
    for action in (ACROSS, int(grid.snap(0.03, 0.0, np.pi / 2)), int(grid.snap(0.0, 0.03, 0.0))):
        assert simulator.run(grasp(), action) == simulator.run(clean, action)
    assert np.array_equal(observe(grasp()).scene, observe(clean).scene)


def test_any_loose_object_may_be_lifted(simulator: Simulator) -> None:
    other = dataclasses.replace(BAR, x_m=0.08, y_m=0.06)
    situation = grasp(others=(other,))
    assert (observe(situation).scene > 0).sum() > 1.8 * (observe(Situation("grasp", 0, BAR)).scene > 0).sum()
    for x, y in ((0.0, 0.0), (0.08, 0.06)):
        assert simulator.run(situation, int(grid.snap(x, y, np.pi / 2))).success


def test_two_objects_at_once_are_none(simulator: Simulator) -> None:
    thin = ObjectSpec(Shape.I, 0.10, 0.02, 0.0, 0.03)
    near, far = Placement(thin, 0.0, -0.013, 0.0), Placement(thin, 0.0, 0.013, 0.0)
    situation = Situation("grasp", 0, near, variation=Variation("clutter", 1, 0, others=(far,)))
    outcome = simulator.run(situation, ACROSS)
    assert not outcome.success


def test_a_hand_that_lands_on_another_object_is_blocked(simulator: Simulator) -> None:
    beside = dataclasses.replace(BAR, y_m=0.058)
    assert simulator.run(grasp(others=(beside,)), ACROSS).failure is Failure.BLOCKED


def test_a_post_may_not_be_touched(simulator: Simulator) -> None:
    post = Placement(ObjectSpec(Shape.I, 0.03, 0.03, 0.0, 0.06), 0.0, 0.058, 0.0)
    situation = grasp(posts=(post,))
    assert observe(situation).scene.max() == 600
    assert simulator.run(situation, ACROSS).failure is Failure.ILLEGAL_CONTACT
    on_it = simulator.run(situation, int(grid.snap(0.0, 0.058, np.pi / 2)))
    assert on_it.failure in (Failure.ILLEGAL_CONTACT, Failure.BLOCKED)


def test_less_friction_and_more_weight_lose_an_object(simulator: Simulator) -> None:
    assert simulator.run(Situation("grasp", 0, BAR), ACROSS).success
    slippery = grasp(world=(("density_kg_m3", 9000.0), ("object_friction", 0.05)))
    assert not simulator.run(slippery, ACROSS).success
    assert simulator.run(Situation("grasp", 0, BAR), ACROSS).success  # the world is the usual one again


def test_a_centre_of_mass_off_the_middle_is_not_seen(simulator: Simulator) -> None:
    """Lifted at its middle, the bar hangs down on one side; the map is the same."""
    heavy = grasp(mass_offset_m=(0.03, 0.0))
    assert np.array_equal(observe(heavy).scene, observe(grasp()).scene)
    assert simulator.run(heavy, ACROSS) != simulator.run(grasp(), ACROSS)


def test_a_smaller_hand_is_seen_and_used(simulator: Simulator) -> None:
    narrow = grasp(world=(("opening_max_m", 0.062),))
    assert not np.array_equal(observe(narrow).depth, observe(grasp()).depth)
    wide = dataclasses.replace(narrow, target=dataclasses.replace(BAR, yaw_rad=np.pi / 2))
    assert simulator.run(wide, ACROSS).failure is Failure.BLOCKED  # 100 mm between fingers 62 mm apart


def test_displacements() -> None:
    pose = (0.10, 0.0, 0.5)
    assert executed(grasp(act=Displacement(0.01, -0.02, 0.1)), pose) == pytest.approx((0.11, -0.02, 0.6))
    turned = executed(grasp(register=Displacement(0.0, 0.0, np.pi / 2)), pose)
    assert turned == pytest.approx((0.0, 0.10, 0.5 + np.pi / 2))  # about the centre of the workspace


def test_noise_is_drawn_once_and_bounded_by_its_size() -> None:
    clean = observe(Situation("grasp", 0, BAR))
    noisy = sensed(clean, Sense(seed=3, noise_m=0.0025, edges=0.5))
    again = sensed(clean, Sense(seed=3, noise_m=0.0025, edges=0.5))
    other = sensed(clean, Sense(seed=4, noise_m=0.0025, edges=0.5))
    assert np.array_equal(noisy.scene, again.scene) and not np.array_equal(noisy.scene, other.scene)
    assert np.array_equal(noisy.mask, clean.mask) and noisy.scene.dtype == np.uint16
    top = noisy.scene[clean.scene == 300].astype(float)
    assert 10 < np.std(top[top > 200]) < 40  # 2.5 mm, in units of 0.1 mm; the edges aside


def test_noise_has_the_standard_deviation_that_it_says() -> None:
    flat = observe(Situation("grasp", 0, dataclasses.replace(BAR, spec=dataclasses.replace(BAR.spec, height_m=0.1))))
    high = dataclasses.replace(flat, scene=np.full((64, 64), 1000, np.uint16))
    seen = np.stack([sensed(high, Sense(seed=n, noise_m=0.002)).scene for n in range(40)]).astype(float)
    assert np.std(seen) == pytest.approx(20, rel=0.1)


def test_a_coarse_camera_averages() -> None:
    clean = observe(Situation("grasp", 0, BAR))
    coarse = sensed(clean, Sense(block=4)).scene
    blocks = coarse.reshape(16, 4, 16, 4)
    assert np.all(blocks == blocks[:, :1, :, :1])
    assert coarse.mean() == pytest.approx(clean.scene.mean(), rel=0.01)
