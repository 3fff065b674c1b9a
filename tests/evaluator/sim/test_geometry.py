"""Shapes, footprints, rasters, profiles and draws: the parts that need no Bullet."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.scenarios.axes.objects import reshaped
from evaluator.sim.footprints import inner_extents
from evaluator.sim.kinds import KINDS
from evaluator.sim.motion import profile
from evaluator.sim.observation import SLAB_M, observe
from evaluator.sim.parameters import WORLD
from evaluator.sim.planar import Rect, paint, separation
from evaluator.sim.reach import valid_actions
from evaluator.sim.shapes import boxes, footprint, inertia_kg_m2, mass_kg
from evaluator.sim.spawn import draw_episode, episode_generator
from rema_data import grid
from rema_data.schema import HEIGHT_STEP_M, SEED_SHAPES, TASKS, Grip, ObjectSpec, Placement, Shape, Situation
from tests.evaluator.sim.conftest import BAR, ELL, HEIGHT, STICK, TEE, held


def spec_of(shape: Shape, length_m: float, width_m: float) -> ObjectSpec:
    spec = ObjectSpec(shape, length_m, width_m, 0.0 if shape is Shape.I else 0.9 * length_m, HEIGHT)
    return spec if shape in SEED_SHAPES else reshaped(spec, shape)


specs = st.builds(
    spec_of,
    st.sampled_from(Shape),
    st.floats(0.07, 0.14),
    st.floats(0.02, 0.045),
)
rects = st.builds(
    Rect,
    st.floats(-0.2, 0.2),
    st.floats(-0.2, 0.2),
    st.floats(-4, 4),
    st.floats(0.005, 0.1),
    st.floats(0.005, 0.1),
)


@given(specs)
def test_the_origin_is_the_centre_of_mass(spec: ObjectSpec) -> None:
    parts = boxes(spec)
    areas = np.array([4 * box.half_x * box.half_y for box in parts])
    assert np.dot(areas, [box.x for box in parts]) == pytest.approx(0, abs=1e-12)
    assert np.dot(areas, [box.y for box in parts]) == pytest.approx(0, abs=1e-12)
    assert mass_kg(spec, 500) == pytest.approx(areas.sum() * spec.height_m * 500)
    assert spec.shape not in SEED_SHAPES or len(parts) == (1 if spec.shape is Shape.I else 2)
    for (n, a), b in product(enumerate(parts), parts):  # each touches another one, and overlaps none
        assert a is b or separation(a, b) >= -1e-12 or spec.shape is Shape.Y
        assert (
            len(parts) == 1
            or min(abs(separation(a, other)) for other in parts[:n] + parts[n + 1 :]) < 1e-9
            or (spec.shape is Shape.Y)
        )


@given(specs)
def test_inertia_against_a_cloud_of_points(spec: ObjectSpec) -> None:
    """Moments of inertia equal the second moments of the filled volume."""
    n = 40
    total = np.zeros(3)
    for box in boxes(spec):
        u = (np.arange(n) + 0.5) / n * 2 - 1
        along, across, z = np.meshgrid(u * box.half_x, u * box.half_y, u * spec.height_m / 2, indexing="ij")
        x = box.x + math.cos(box.yaw) * along - math.sin(box.yaw) * across
        y = box.y + math.sin(box.yaw) * along + math.cos(box.yaw) * across
        weight = 4 * box.half_x * box.half_y * spec.height_m * 500 / n**3
        total += weight * np.array([(y**2 + z**2).sum(), (x**2 + z**2).sum(), (x**2 + y**2).sum()])
    assert inertia_kg_m2(spec, 500) == pytest.approx(total, rel=2e-3)


def corners(rect: Rect) -> np.ndarray:
    c, s = math.cos(rect.yaw), math.sin(rect.yaw)
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * [rect.half_x, rect.half_y]
    return signs @ np.array([[c, s], [-s, c]]) + [rect.x, rect.y]


@given(rects, rects)
def test_separation_never_exceeds_the_distance(a: Rect, b: Rect) -> None:
    """A positive separation is a proof that two rectangles do not meet: no sampled pair of points is closer."""
    bound = separation(a, b)
    t = np.linspace(0, 1, 9)[:, None]
    edges = [
        np.concatenate([p + (q - p) * t for p, q in zip(c, np.roll(c, -1, 0), strict=True)])
        for c in map(corners, (a, b))
    ]
    nearest = np.linalg.norm(edges[0][:, None] - edges[1][None], axis=-1).min()
    assert bound <= nearest + 1e-12
    assert separation(b, a) == pytest.approx(bound, abs=1e-12)


@given(rects)
def test_extent_covers_the_corners(rect: Rect) -> None:
    for direction in (0.0, 0.7, math.pi / 2):
        along = corners(rect) @ [math.cos(direction), math.sin(direction)]
        assert rect.extent(direction) == pytest.approx((along.min(), along.max()), abs=1e-12)


@given(rects)
def test_paint_fills_what_is_inside(rect: Rect) -> None:
    image = np.zeros((grid.SCENE_PIXELS,) * 2, np.uint16)
    paint(image, rect, 7, grid.SCENE_HALF_M)
    centres = grid.pixel_centres(grid.SCENE_PIXELS)
    x, y = np.meshgrid(centres, centres)
    c, s = math.cos(rect.yaw), math.sin(rect.yaw)
    dx, dy = x - rect.x, y - rect.y
    inside = (np.abs(c * dx + s * dy) <= rect.half_x) & (np.abs(c * dy - s * dx) <= rect.half_y)
    assert ((image == 7) == inside).all()


@given(st.floats(0.005, 0.4), st.floats(0.05, 1.5))
def test_profiles_start_and_end_at_rest_and_keep_the_speed(distance: float, speed: float) -> None:
    tick = WORLD.time_step_s * WORLD.control_every
    shares = profile(distance, speed, tick, WORLD.ramp_share)
    steps = np.diff(shares) * distance / tick
    assert shares[0] == 0.0
    assert shares[-1] == pytest.approx(1.0)
    assert (steps >= -1e-12).all()
    assert steps.max() <= speed * 1.0001


@pytest.mark.parametrize("task", TASKS)
def test_draws_are_keyed_by_episode_and_stay_in_range(task: str) -> None:
    first = [draw_episode(episode_generator(1, "test", task, n), task) for n in range(40)]
    again = [draw_episode(episode_generator(1, "test", task, n), task) for n in reversed(range(40))][::-1]
    other = [draw_episode(episode_generator(1, "collect", task, n), task) for n in range(40)]
    assert first == again
    assert not set(first) & set(other)
    two_arms = any(KINDS[kind].two_arms for kind in TASKS[task])
    for placements in first:
        for kind, placement in zip(TASKS[task], placements, strict=True):
            spec = placement.spec
            if two_arms and KINDS[kind].bare:
                assert spec.shape is Shape.I
                assert WORLD.stick_length_min_m <= spec.length_m <= WORLD.stick_length_max_m
            else:
                assert WORLD.length_min_m <= spec.length_m <= WORLD.length_max_m
            assert max(abs(placement.x_m), abs(placement.y_m)) <= 0.11


def test_candidates_leave_room_for_the_fingers() -> None:
    rng, grasp = np.random.default_rng(0), KINDS[TASKS["grasp"][0]]
    valid = valid_actions("grasp", 0).reshape(-1)
    for spec in (BAR, TEE, ELL, STICK):
        found = list(grasp.candidates(Placement(spec, 0.01, 0.02, 0.3), valid, rng, WORLD))
        assert found, spec
        assert all(0 <= action < grid.ACTIONS for action in found)


def test_maps_of_a_bare_hand() -> None:
    grasp = observe(Situation("grasp", 0, Placement(BAR, 0, 0, 0)))
    opened, closed = grasp.mask
    assert opened.sum() == closed.sum() or abs(int(opened.sum()) - int(closed.sum())) < 12
    columns = np.flatnonzero(opened.any(axis=0))
    assert (columns.max() - columns.min() + 1) * grid.PIXEL_M == pytest.approx(
        WORLD.opening_max_m + 2 * WORLD.finger_thickness_m, abs=2 * grid.PIXEL_M
    )
    assert set(np.unique(grasp.depth)) == {0, round(SLAB_M / HEIGHT_STEP_M)}
    assert (opened == opened[:, ::-1]).all()
    assert (opened == opened[::-1]).all()
    push = observe(Situation("push", 0, Placement(BAR, 0, 0, 0)))
    assert (push.mask[0] == push.mask[1]).all()
    assert (push.mask[0] == closed).all()


def test_the_scene_shows_the_object_where_it_is() -> None:
    scene = observe(Situation("grasp", 0, Placement(BAR, 0.05, -0.02, 0.0))).scene_m()
    rows, columns = np.nonzero(scene)
    assert (columns.mean() + 0.5) * grid.PIXEL_M - grid.SCENE_HALF_M == pytest.approx(0.05, abs=grid.PIXEL_M / 2)
    assert (rows.mean() + 0.5) * grid.PIXEL_M - grid.SCENE_HALF_M == pytest.approx(-0.02, abs=grid.PIXEL_M / 2)
    assert scene.max() == pytest.approx(HEIGHT)
    assert scene.dtype == np.float32


def test_a_mask_is_what_may_touch() -> None:
    seen = observe(Situation("grasp_push", 1, Placement(TEE, 0.05, 0, 0), (held(BAR),)))
    area = seen.mask[0].sum() * grid.PIXEL_M**2
    assert area == pytest.approx(BAR.length_m * BAR.width_m, rel=0.15)
    fingers = (seen.depth[0] > 0) & ~seen.mask[0]
    assert fingers.sum() * grid.PIXEL_M**2 == pytest.approx(
        2 * WORLD.finger_lateral_m * WORLD.finger_thickness_m, rel=0.5
    )
    assert (seen.depth[0] == seen.depth[1]).all()


@settings(max_examples=30)
@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_tips_of_two_sticks_stand_equally_far_from_the_middle(left: float, right: float) -> None:
    grips: tuple[Grip, ...] = (held(STICK, along_m=left), held(STICK, along_m=right))
    # y of the left hand (a quarter turn) points to -x of the pair, y of the right hand to +x: inwards for both
    assert sum(inner_extents(grips)) == pytest.approx(STICK.length_m + left + right)
    seen = observe(Situation("grasp_grasp", 2, Placement(BAR, 0, 0, 0), grips))
    columns = np.flatnonzero(seen.mask[0].any(axis=0)) - (grid.EE_PIXELS - 1) / 2
    gap_right, gap_left = columns[columns > 0].min(), -columns[columns < 0].max()
    assert abs(gap_right - gap_left) <= 1
    assert gap_right * grid.PIXEL_M == pytest.approx(WORLD.pair_open_m, abs=grid.PIXEL_M)


def test_footprint_moves_with_the_object() -> None:
    here = footprint(Placement(ELL, 0.0, 0.0, 0.0))
    there = footprint(Placement(ELL, 0.1, -0.05, 1.0))
    for a, b in zip(here, there, strict=True):
        moved = a.moved(0.1, -0.05, 1.0)
        assert moved == pytest.approx(b)
