"""The painted maps are what cameras see: four views of the end effector, one of the scene."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from evaluator.sim.footprints import inner_extents
from evaluator.sim.observation import end_effector_states, observe, paint_parts
from evaluator.sim.shapes import boxes
from evaluator.sim.spawn import draw_placement, draw_spec
from evaluator.sim.world import World
from rema_data import grid
from rema_data.schema import SEED_SHAPES, TASKS, Grip, ObjectSpec, Pinch, Placement, Shape, Situation
from tests.evaluator.sim.cameras import capture_end_effector, capture_scene, point_cloud, scene_camera

Array = npt.NDArray[Any]

TOOL = ObjectSpec(Shape.L, 0.12, 0.03, 0.108, 0.03)
STICK = ObjectSpec(Shape.I, 0.19, 0.028, 0.0, 0.03)
TEE = ObjectSpec(Shape.T, 0.11, 0.025, 0.099, 0.03)
TARGET = Placement(TEE, 0.05, -0.04, 0.7)
STICKS = (Grip(STICK, 0.001, 0.01, 0.01, 1.6, 0.028), Grip(STICK, -0.001, -0.012, 0.014, 1.5, 0.028))


def pinch_across(spec: ObjectSpec, grips: tuple[Grip, ...]) -> Pinch:
    """The main bar of an I or an L between the tips, across the pair's axis."""
    bar = boxes(spec)[0]
    left, right = (extent + spec.width_m / 2 for extent in inner_extents(grips))
    return Pinch(spec, bar.y, -bar.x, 0.012, math.pi / 2, left, right)


SITUATIONS = {
    "gripper_grasp": Situation("grasp", 0, TARGET),
    "gripper_push": Situation("push", 0, TARGET),
    "tool": Situation("grasp_push", 1, TARGET, (Grip(TOOL, 0.004, 0.02, 0.012, 0.4, 0.03),)),
    "sticks": Situation("grasp_grasp", 2, TARGET, STICKS),
    "pinched": Situation("grasp_grasp_push", 3, TARGET, STICKS, pinch_across(TOOL, STICKS)),
}


def near(mask: Array, pixels: int = 1) -> Array:
    """Mask grown by so many pixels in all eight directions."""
    grown = np.zeros_like(mask)
    size = mask.shape[0]
    padded = np.pad(mask, pixels)
    for i in range(2 * pixels + 1):
        for j in range(2 * pixels + 1):
            grown |= padded[i : i + size, j : j + size]
    return grown


def iou(a: Array, b: Array) -> float:
    return float((a & b).sum() / (a | b).sum())


def assert_within_a_pixel(seen: Array, painted: Array) -> None:
    assert painted.any()
    assert not (seen & ~near(painted)).any()
    assert not (painted & ~near(seen)).any()


def assert_same(seen: Array, painted: Array, least_iou: float = 0.9) -> None:
    """Two height maps: footprints equal within a pixel, heights within 1 mm away from edges."""
    assert_within_a_pixel(seen > 0, painted > 0)
    assert iou(seen > 0, painted > 0) > least_iou
    inside = (
        ~near(painted != np.roll(painted, 1, 0)) & ~near(painted != np.roll(painted, 1, 1)) & (painted > 0) & (seen > 0)
    )
    assert np.abs(seen.astype(int) - painted.astype(int))[inside].max(initial=0) <= 10


def assert_maps_agree(situation: Situation, least_iou: float = 0.9) -> None:
    painted = observe(situation)
    depth, mask = capture_end_effector(situation)
    for state in range(2):
        assert_same(depth[state], painted.depth[state], least_iou)
        assert_within_a_pixel(mask[state], painted.mask[state])
        assert iou(mask[state], painted.mask[state]) > least_iou


def painted_at(situation: Situation, yaw: float) -> Array:
    """Mask of the first state, painted with the end effector turned."""
    parts = end_effector_states(situation)[0]
    return paint_parts([part._replace(rect=part.rect.moved(0.0, 0.0, yaw)) for part in parts])[1]


def turned(mask: Array, yaw: float) -> Array:
    """A yaw-0 mask turned about the middle of the map: the pixel under every turned pixel centre."""
    centres = grid.pixel_centres(grid.EE_PIXELS)
    x, y = np.meshgrid(centres, centres)
    c, s = math.cos(yaw), math.sin(yaw)
    row, column = (
        np.clip(np.floor((value + grid.EE_HALF_M) / grid.PIXEL_M).astype(int), 0, grid.EE_PIXELS - 1)
        for value in (c * y - s * x, c * x + s * y)
    )
    return np.asarray(mask[row, column])


@pytest.mark.parametrize("name", SITUATIONS)
def test_four_cameras_see_the_painted_end_effector(name: str) -> None:
    assert_maps_agree(SITUATIONS[name])


def test_what_a_gripper_shows() -> None:
    depth, mask = capture_end_effector(SITUATIONS["gripper_grasp"])
    assert depth.max() == 500  # fingers are longer than the slab is high
    assert (mask == (depth > 0)).all()


def test_one_camera_sees_the_painted_scene() -> None:
    rng = np.random.default_rng(1)
    for shape in Shape:
        spec = ObjectSpec(shape, 0.11, 0.03, 0.0 if shape is Shape.I else 0.09, 0.03)
        x, y, yaw = rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08), rng.uniform(0, 2 * math.pi)
        situation = Situation("grasp", 0, Placement(spec, float(x), float(y), float(yaw)))
        seen, painted = capture_scene(situation), observe(situation).scene
        if shape in SEED_SHAPES:
            assert_same(seen, painted)
        else:  # one camera does not see the ground behind a wall, inside of the shape
            assert not ((painted > 0) & ~near(seen > 0)).any()


def test_reprojection_finds_a_box_to_a_millimetre() -> None:
    """Half a pixel of the image is 0.27 mm: a wrong optical axis would show."""
    rng = np.random.default_rng(2)
    world = World(())
    length, width = 0.10, 0.03
    for _ in range(5):
        x, y = (float(value) for value in rng.uniform(-0.08, 0.08, 2))
        yaw = float(rng.uniform(0, 2 * math.pi))
        world.begin()
        body = world.place(ObjectSpec(Shape.I, length, width, 0.0, 0.03), x, y, 0.015, yaw)
        points = point_cloud(world.client, scene_camera(), [body]).points
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = points[:, 0] - x, points[:, 1] - y
        along, across = c * dx + s * dy, c * dy - s * dx
        assert abs(along.max() + along.min()) / 2 < 5e-4
        assert abs(across.max() + across.min()) / 2 < 5e-4
        assert np.ptp(along) * np.ptp(across) == pytest.approx(length * width, rel=0.05)
        assert points[:, 2].max() == pytest.approx(0.03, abs=1e-4)
    world.close()


def boxes_on_the_map(count: int, seed: int, capture: bool) -> tuple[Array, Array]:
    """Centre errors (m, (n, 2)) and areas over the true ones of boxes at random poses."""
    rng = np.random.default_rng(seed)
    errors, areas = [], []
    for _ in range(count):
        length, width = float(rng.uniform(0.09, 0.135)), float(rng.uniform(0.03, 0.045))
        x, y = (float(value) for value in rng.uniform(-0.06, 0.06, 2))
        spec = ObjectSpec(Shape.I, length, width, 0.0, 0.03)
        situation = Situation("grasp", 0, Placement(spec, x, y, float(rng.uniform(0, 2 * math.pi))))
        row, column = np.nonzero(capture_scene(situation) if capture else observe(situation).scene)
        centres = grid.pixel_centres(grid.SCENE_PIXELS)
        errors.append((centres[column].mean() - x, centres[row].mean() - y))
        areas.append(len(row) * grid.PIXEL_M**2 / (length * width))
    return np.array(errors), np.array(areas)


def check_boxes(errors: Array, areas: Array) -> None:
    # an edge along the pixel grid may lie anywhere in a pixel, which bounds single boxes; there is no bias
    assert np.abs(errors).max() < grid.PIXEL_M / 2
    assert np.median(np.hypot(*errors.T)) < 1e-3
    assert np.abs(errors.mean(axis=0)).max() < 4e-4
    assert np.median(np.abs(areas - 1)) < 0.05
    assert areas.mean() == pytest.approx(1.0, abs=0.015)


def test_boxes_keep_their_place_and_size_on_the_painted_map() -> None:
    check_boxes(*boxes_on_the_map(200, 3, capture=False))


@pytest.mark.parametrize("name", SITUATIONS)
@pytest.mark.parametrize("k", range(1, 16))
def test_a_turned_map_is_the_map_of_a_turned_end_effector(name: str, k: int) -> None:
    situation, yaw = SITUATIONS[name], k * 2 * math.pi / grid.ANGLES
    straight, expected = painted_at(situation, 0.0), painted_at(situation, yaw)
    result = turned(straight, yaw)
    if k % 4 == 0:
        assert (result == expected).all()
        return
    assert_within_a_pixel(result, expected)
    if straight.sum() > 100:  # a finger is 4 x 2 pixels: only "within a pixel" means something
        assert iou(result, expected) > 0.85


def test_the_camera_sees_a_turned_tool_where_it_is_painted() -> None:
    for k in (1, 6):
        yaw = k * 2 * math.pi / grid.ANGLES
        _, mask = capture_end_effector(SITUATIONS["tool"], yaw_rad=yaw)
        expected = painted_at(SITUATIONS["tool"], yaw)
        assert_within_a_pixel(mask[0], expected)
        assert iou(mask[0], expected) > 0.95


def random_situations(count: int, seed: int) -> list[Situation]:
    """Situations of all tool tasks with tools held anywhere near their middle."""
    rng = np.random.default_rng(seed)

    def grip(stick: bool) -> Grip:
        spec = draw_spec(rng, stick)
        x, y = (float(value) for value in rng.uniform(-0.005, 0.005, 2))
        turn = math.pi / 2 if stick else 0.0
        yaw = turn + float(rng.normal(0, 0.05))
        return Grip(spec, x, y, float(rng.uniform(0.008, 0.014)), yaw, spec.width_m)

    situations = []
    for number in range(count):
        task = ("grasp_push", "grasp_grasp", "grasp_grasp_push")[number % 3]
        last = len(TASKS[task]) - 1
        target = draw_placement(rng, TASKS[task][last], False)
        grips = (grip(False),) if task == "grasp_push" else (grip(True), grip(True))
        pinch = None
        if task == "grasp_grasp_push":
            shape = Shape.L if number % 2 else Shape.I
            spec = ObjectSpec(shape, float(rng.uniform(0.09, 0.13)), 0.03, 0.08 if number % 2 else 0.0, 0.03)
            pinch = pinch_across(spec, grips)
        situations.append(Situation(task, last, target, grips, pinch))
    return situations


@pytest.mark.slow
def test_many_random_tools_agree() -> None:
    for situation in random_situations(60, 4):
        assert_maps_agree(situation)


@pytest.mark.slow
def test_many_random_scenes_agree() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        situation = Situation("grasp", 0, draw_placement(rng, TASKS["grasp"][0], False))
        assert_same(capture_scene(situation), observe(situation).scene)
    check_boxes(*boxes_on_the_map(60, 6, capture=True))
