"""Inverse kinematics against Bullet's forward kinematics, joint limits, and the distance between two arms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from evaluator.sim.kinds import KINDS
from evaluator.sim.kinematics import (
    LIMITS_RAD,
    LOWER_M,
    SHOULDER_M,
    UPPER_M,
    WRIST_M,
    Array,
    Base,
    base_of,
    joint_limits,
    solve,
    solve_path,
)
from evaluator.sim.parameters import WORLD
from evaluator.sim.reach import acting_arm, reachable, valid_actions
from evaluator.sim.simulator import Simulator
from rema_data import grid
from rema_data.schema import TASKS, StepKind


@pytest.mark.parametrize("arm", ["left", "right"])
def test_round_trip_over_the_reach_mask(simulator: Simulator, arm: str) -> None:
    world = simulator.world
    rng = np.random.default_rng(0)
    cells = np.argwhere(reachable(TASKS["grasp"][0])[0 if arm == "left" else 1])
    worst = worst_yaw = 0.0
    for i, j, k in rng.choice(cells, 150):
        x, y, yaw = (float(value) for value in grid.to_world(grid.encode(i, j, k)))
        z = float(rng.choice([WORLD.grasp_height_m, 0.1, WORLD.lift_height_m]))
        world.begin((arm,))
        body = world.arms[arm]
        joints = solve_path(body.base, [x], [y], [z], [yaw], True)[0]
        body.reset(joints, 0.05)
        world.client.getLinkState(body.body, 6, computeForwardKinematics=1)
        px, py, pz, pyaw = body.hand_pose()
        worst = max(worst, math.dist((x, y, z), (px, py, pz)))
        worst_yaw = max(worst_yaw, abs((pyaw - yaw + math.pi / 2) % math.pi - math.pi / 2))
    assert worst < 1e-6
    assert worst_yaw < 1e-5


def test_out_of_reach_is_not_a_number() -> None:
    base = base_of("left")
    assert np.isnan(solve(base, 3.0, 0.0, 0.1, 0.0)).any()


def test_only_joint_4_exceeds_the_real_arm() -> None:
    exceeds = joint_limits() > LIMITS_RAD
    assert exceeds.tolist() == [False, False, False, True, False, False, False]


def test_paths_are_continuous() -> None:
    """A joint 7 that wraps on the way would spin the hand by a full turn."""
    base = base_of("left")
    x = np.linspace(-0.12, 0.42, 200)
    for yaw in np.arange(16) * 2 * np.pi / 16:
        joints = solve_path(base, x, np.zeros(200), np.full(200, 0.01), np.full(200, yaw), False)
        assert np.abs(np.diff(joints, axis=0)).max() < 0.05


def test_single_arm_tasks_reach_the_whole_square() -> None:
    inside = grid.inside_valid_square().sum() * grid.ANGLES
    for task, step in (("grasp", 0), ("push", 0)):
        assert valid_actions(task, step).sum() == inside
    assert valid_actions("grasp_push", 1).sum() > 0.99 * inside


def test_a_pair_keeps_to_half_the_angles() -> None:
    assert not valid_actions("grasp_grasp", 2)[:, :, grid.PAIR_ANGLES :].any()
    assert valid_actions("grasp_grasp", 2).any(axis=(0, 1))[: grid.PAIR_ANGLES].all()


def test_arms_are_chosen_by_reach() -> None:
    middle = grid.encode(30, 30, 0)
    assert acting_arm("grasp", 0, middle) == "left"
    assert [acting_arm("grasp_grasp", step, middle) for step in range(3)] == ["left", "right", "both"]
    assert acting_arm("grasp_grasp", 2, grid.encode(30, 30, 9)) is None
    assert acting_arm("grasp", 0, grid.encode(0, 30, 0)) is None


def joint_points(base: Base, joints: Array) -> Array:
    """Shoulder, elbow, wrist and flange of an arm, float64 (4, ..., 3), world frame, for joints of ``solve``."""
    heading = joints[..., 0] + base.yaw_rad
    lean = joints[..., 1]
    radii = [np.zeros_like(lean), UPPER_M * np.sin(lean)]
    heights = [np.full_like(lean, base.z_m + SHOULDER_M), base.z_m + SHOULDER_M + UPPER_M * np.cos(lean)]
    reach = lean - joints[..., 3]
    radii.append(radii[1] + LOWER_M * np.sin(reach))
    heights.append(heights[1] + LOWER_M * np.cos(reach))
    radii.append(radii[2])
    heights.append(heights[2] - WRIST_M)
    return np.stack(
        [
            np.stack([base.x_m + r * np.cos(heading), base.y_m + r * np.sin(heading), h], axis=-1)
            for r, h in zip(radii, heights, strict=True)
        ]
    )


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Smallest distance between segments a and b, float64 (...,), for end points (..., 3)."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    denominator = uu * vv - uv * uv
    safe = np.where(denominator > 1e-12, denominator, 1.0)
    s = np.clip(np.where(denominator > 1e-12, (uv * vw - vv * uw) / safe, 0.0), 0, 1)
    t = np.clip((uv * s + vw) / vv, 0, 1)
    s = np.clip((uv * t - uw) / uu, 0, 1)
    return np.asarray(np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1))


def test_two_arms_keep_clear_of_each_other() -> None:
    """Wrists and forearms as capsules of the real links' width, at the closest that two sticks can bring the hands."""
    thick = 0.065
    shortest = WORLD.stick_length_min_m * (0.5 - 0.12)
    apart = shortest + WORLD.pair_empty_m
    i, j, k = np.nonzero(valid_actions("grasp_grasp", 2))
    x, y, theta = grid.to_world(grid.encode(i, j, k))
    for lift in (0.0, WORLD.pair_lift_height_m):
        arms = []
        for arm, side, turn in (("left", 1.0, np.pi / 2), ("right", -1.0, 3 * np.pi / 2)):
            px, py = x + side * apart * np.cos(theta), y + side * apart * np.sin(theta)
            joints = solve(base_of(arm), px, py, np.full(px.shape, 0.01 + lift), theta + turn)
            arms.append(joint_points(base_of(arm), joints))
        closest = min(
            float(segment_distance(arms[0][a], arms[0][a + 1], arms[1][b], arms[1][b + 1]).min())
            for a in range(3)
            for b in range(3)
        )
        assert closest > 2 * thick, closest


@pytest.mark.parametrize("kind", KINDS)
def test_arms_keep_above_the_table(kind: StepKind) -> None:
    for side, arm in enumerate(("left", "right")):
        i, j, k = np.nonzero(reachable(kind)[side])
        x, y, theta = grid.to_world(grid.encode(i, j, k))
        far = KINDS[kind].reach_distances(WORLD)[-1]
        sign = 1.0 if arm == "left" else -1.0
        px, py = x + sign * far * np.cos(theta), y + sign * far * np.sin(theta)
        points = joint_points(base_of(arm), solve(base_of(arm), px, py, np.full(px.shape, 0.005), theta))
        assert points[1:3, :, 2].min() > 0.15  # elbow and wrist; the hand itself works at the table
