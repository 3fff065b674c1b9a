"""The camera path of the paper: point clouds of real bodies, projected to height maps.

The evaluator uses ``observation.py``, which paints the same maps from the known boxes. This module checks that both
agree, and nothing else depends on it: it takes about a second a situation.

The scene is seen by one camera from above, the end effector by four around its centre. Every image pixel is a point
of the body that the segmentation names there. Each body's points become a filled footprint on the map; the map holds
the highest body of every pixel.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pybullet

from evaluator.sim.kinds import kind_of
from evaluator.sim.kinematics import base_of, solve
from evaluator.sim.observation import SLAB_M
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.robots import FINGER_JOINTS
from evaluator.sim.staging import HandPose, target_thing
from evaluator.sim.world import World
from rema_data.grid import EE_HALF_M, EE_PIXELS, PIXEL_M, SCENE_HALF_M, SCENE_PIXELS, pixel_centres
from rema_data.schema import HEIGHT_STEP_M, Situation

__all__ = ["Camera", "capture_end_effector", "capture_scene", "end_effector_cameras", "point_cloud", "scene_camera"]

Array = npt.NDArray[Any]

AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
ELEVATION_DEG = 35.0
DISTANCE_M = 0.8
CAPTURE_HEIGHT_M = 0.35
"""Where the end effector is held while it is photographed: far above the table."""
BAND_M = 0.0006
"""A map row (or column) takes part of a footprint's outline from the points this near to its centre line: about the
distance between two points of the cloud."""
_BODY_BITS = (1 << 24) - 1


class Camera(NamedTuple):
    """A square pinhole camera: position and aim (m, world), field of view (deg), image edge, clipping planes (m)."""

    eye: tuple[float, float, float]
    aim: tuple[float, float, float]
    up: tuple[float, float, float]
    fov_deg: float
    pixels: int
    near_m: float
    far_m: float


class Cloud(NamedTuple):
    """Points (m, world, float64 (n, 3)) and the body and link that each belongs to (int (n,))."""

    points: Array
    body: Array
    link: Array


def scene_camera() -> Camera:
    """One camera straight above the workspace, image rows from +y down to -y."""
    height = 1.0
    fov = 2 * math.degrees(math.atan((SCENE_HALF_M + 0.02) / (height - 0.05)))
    return Camera((0.0, 0.0, height), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), fov, 576, 0.5, 1.1)


def end_effector_cameras(centre: tuple[float, float, float]) -> list[Camera]:
    """Four cameras around the end effector, looking down on its centre."""
    cameras = []
    elevation = math.radians(ELEVATION_DEG)
    for azimuth in (math.radians(value) for value in AZIMUTHS_DEG):
        eye = (
            centre[0] + DISTANCE_M * math.cos(elevation) * math.cos(azimuth),
            centre[1] + DISTANCE_M * math.cos(elevation) * math.sin(azimuth),
            centre[2] + DISTANCE_M * math.sin(elevation),
        )
        cameras.append(Camera(eye, centre, (0.0, 0.0, 1.0), 40.0, 1024, 0.3, 1.4))
    return cameras


def point_cloud(client: Any, camera: Camera, bodies: Collection[int]) -> Cloud:
    """What a camera sees of some bodies; the others hide what is behind them, and are left out.

    Notes
    -----
    TinyRenderer samples at whole pixel coordinates and then turns the rows round: the optical axis is at column W / 2
    and row H / 2 - 1, rows counted from the top.
    """
    size = camera.pixels
    view = client.computeViewMatrix(camera.eye, camera.aim, camera.up)
    projection = client.computeProjectionMatrixFOV(camera.fov_deg, 1.0, camera.near_m, camera.far_m)
    _, _, _, depth, segments = client.getCameraImage(
        size,
        size,
        view,
        projection,
        shadow=0,
        flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
        renderer=pybullet.ER_TINY_RENDERER,
    )
    label = np.asarray(segments).reshape(size, size)
    # the background is -1, which is not a body
    row, column = np.nonzero(np.isin(np.where(label < 0, -1, label & _BODY_BITS), list(bodies)))
    label = label[row, column]
    buffer = np.asarray(depth, np.float64).reshape(size, size)[row, column]
    near, far = camera.near_m, camera.far_m
    distance = 2 * near * far / (far + near - (2 * buffer - 1) * (far - near))
    x = (column - size / 2) / (size / 2) * distance / projection[0]
    y = (size / 2 - 1 - row) / (size / 2) * distance / projection[5]
    seen = np.stack([x, y, -distance], axis=1)
    matrix = np.asarray(view).reshape(4, 4).T
    points = (seen - matrix[:3, 3]) @ matrix[:3, :3]
    return Cloud(points, label & _BODY_BITS, (label >> 24) - 1)


def capture_scene(situation: Situation, parameters: WorldParameters = WORLD) -> npt.NDArray[np.uint16]:
    """Height map of the table from one top-down camera.

    Parameters
    ----------
    situation : Situation
    parameters : WorldParameters

    Returns
    -------
    uint16 (64, 64)
        In units of 0.1 mm, as ``observe(situation).scene``. Robots are filtered out: none is loaded.
    """
    world = World((), parameters)
    try:
        body = world.put(target_thing(situation))
        cloud = point_cloud(world.client, scene_camera(), [body])
    finally:
        world.close()
    covered, height = _footprint(cloud.points, SCENE_PIXELS, SCENE_HALF_M)
    return np.where(covered, _quantised(height), 0).astype(np.uint16)


def capture_end_effector(
    situation: Situation, parameters: WorldParameters = WORLD, yaw_rad: float = 0.0
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.bool_]]:
    """Maps of the end effector in its two states from four cameras.

    Parameters
    ----------
    situation : Situation
    parameters : WorldParameters
    yaw_rad : float
        Of the hand or the pair; a policy's maps are at 0.

    Returns
    -------
    depth : uint16 (2, 112, 112)
        In units of 0.1 mm above the lowest allowed point, cut at 5 cm, as ``observe(situation).depth``.
    mask : bool (2, 112, 112)
        Whether the topmost body may touch the target.
    """
    depth = np.zeros((2, EE_PIXELS, EE_PIXELS), np.uint16)
    mask = np.zeros((2, EE_PIXELS, EE_PIXELS), np.bool_)
    kind = kind_of(situation)
    world = World(("left", "right") if kind.two_arms else ("left",), parameters)
    try:
        pose = (0.0, 0.0, yaw_rad)
        states = [kind.hands(situation, pose, CAPTURE_HEIGHT_M, closed=end, p=parameters) for end in (False, True)]
        for number, hands in enumerate(states):
            if number == 0 or hands != states[0]:  # else nothing closes
                depth[number:], mask[number:] = _capture_state(world, situation, hands, pose)
    finally:
        world.close()
    return depth, mask


def _capture_state(
    world: World, situation: Situation, hands: list[HandPose], pose: tuple[float, float, float]
) -> tuple[Array, Array]:
    world.begin()
    for hand in hands:
        base = base_of(hand.arm, world.parameters)
        joints = solve(base, hand.x_m, hand.y_m, hand.z_m, hand.yaw_rad, world.parameters)
        world.arms[hand.arm].reset(joints, hand.opening_m)
    kind = kind_of(situation)
    things = kind.held(situation, hands, pose)
    bodies = [world.put(thing) for thing in things]
    arms = [world.arms[hand.arm].body for hand in hands]
    allowed = {(body, -1) for body, thing in zip(bodies, things, strict=True) if thing.role == kind.role}
    if kind.bare:
        allowed = {(body, link) for body in arms for link in FINGER_JOINTS}
    return _fuse(world, {*arms, *bodies}, allowed)


def _fuse(world: World, bodies: set[int], allowed: set[tuple[int, int]]) -> tuple[Array, Array]:
    """Depth and mask of some bodies from the clouds of all four cameras."""
    cameras = end_effector_cameras((0.0, 0.0, CAPTURE_HEIGHT_M))
    clouds = [point_cloud(world.client, camera, bodies) for camera in cameras]
    points = np.concatenate([cloud.points for cloud in clouds])
    body, link = (np.concatenate([cloud[n] for cloud in clouds]) for n in (1, 2))
    pieces = sorted(set(zip(body.tolist(), link.tolist(), strict=True)))
    members = {piece: points[(body == piece[0]) & (link == piece[1])] for piece in pieces}
    floor = min(members[piece][:, 2].min() for piece in pieces if piece in allowed)
    depth = np.zeros((EE_PIXELS, EE_PIXELS), np.uint16)
    top = np.zeros((EE_PIXELS, EE_PIXELS), np.uint16)
    for piece in pieces:
        above = members[piece] - [0.0, 0.0, floor]
        if above[:, 2].min() >= SLAB_M:
            continue
        # what passes through the slab's ceiling is solid up to there: all its points count, cut at the ceiling
        above[:, 2] = np.minimum(above[:, 2], SLAB_M)
        covered, height = _footprint(above, EE_PIXELS, EE_HALF_M)
        values = np.where(covered, _quantised(height), 0).astype(np.uint16)
        np.maximum(depth, values, out=depth)
        if piece in allowed:
            np.maximum(top, values, out=top)
    return depth, (top > 0) & (top >= depth)


def _footprint(points: Array, pixels: int, half_m: float) -> tuple[Array, Array]:
    """Footprint and height of one body from its points.

    A pixel belongs to the footprint if the body has points on all four sides of its centre, in its row and in its
    column: that also fills what is hidden from every camera, but not the inner corner of an L or a T.

    Returns
    -------
    covered : bool (pixels, pixels)
    height : float64 (pixels, pixels)
        Highest point of every pixel, metres; the body's highest where the pixel has none.
    """
    centres = pixel_centres(pixels)
    x_low, x_high = _outline(points[:, 1], points[:, 0], centres, half_m)
    y_low, y_high = _outline(points[:, 0], points[:, 1], centres, half_m)
    in_row = (x_low[:, None] <= centres) & (centres <= x_high[:, None])
    in_column = (y_low <= centres[:, None]) & (centres[:, None] <= y_high)
    height = np.zeros((pixels, pixels))
    cells = np.floor((points[:, :2] + half_m) / PIXEL_M).astype(int)
    inside = ((cells >= 0) & (cells < pixels)).all(axis=1)
    np.maximum.at(height, (cells[inside, 1], cells[inside, 0]), points[inside, 2])
    height[height == 0] = points[:, 2].max()
    return in_row & in_column, height


def _outline(across: Array, along: Array, centres: Array, half_m: float) -> tuple[Array, Array]:
    """Smallest and largest ``along`` of the points near every line ``across = centre``; an empty range if none."""
    line = np.floor((across + half_m) / PIXEL_M).astype(int)
    near = (line >= 0) & (line < len(centres))
    line, across, along = line[near], across[near], along[near]
    near = np.abs(across - centres[line]) <= BAND_M
    low, high = np.full(len(centres), np.inf), np.full(len(centres), -np.inf)
    np.minimum.at(low, line[near], along[near])
    np.maximum.at(high, line[near], along[near])
    return low, high


def _quantised(height: Array) -> Array:
    return np.rint(np.clip(height, 0.0, None) / HEIGHT_STEP_M)
