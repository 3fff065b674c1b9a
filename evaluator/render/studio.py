"""Photographs of a step: both arms with their meshes, the objects in colours, the table. Nothing moves here.

The studio is a Bullet client of its own, without physics: it shows poses that were simulated (or staged) elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
import pybullet
import pybullet_data

from evaluator.render.arms import dressed_urdf
from evaluator.render.colours import COLOURS, Colour
from evaluator.sim import robots
from evaluator.sim.kinematics import base_of, solve, solve_path
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.shapes import boxes
from evaluator.sim.staging import HandPose, Thing
from evaluator.sim.world import World
from rema_data.schema import ObjectSpec

if TYPE_CHECKING:
    from PIL import Image

__all__ = [
    "CLOSE_UP",
    "ROOM",
    "Body",
    "Marker",
    "Shot",
    "Studio",
    "View",
    "about_z",
    "shot_of_stage",
    "shot_of_world",
]

Array = npt.NDArray[Any]
_TABLE: Colour = (0.80, 0.76, 0.70, 1.0)
_SHADE: Colour = (0.66, 0.62, 0.56, 1.0)
_COLUMN: Colour = (0.34, 0.36, 0.40, 1.0)
_CARRIAGE: Colour = (0.45, 0.46, 0.50, 1.0)
_OVERSAMPLING = 2
_IDLE = (-0.22, 0.22, 0.42)
"""Where the hand of an arm that does not act waits: x, distance from the middle towards its base, z (m)."""


class View(NamedTuple):
    """Where a camera stands and looks (m), and its vertical field of view (degrees)."""

    eye: tuple[float, float, float]
    aim: tuple[float, float, float]
    fov_deg: float


ROOM = View((1.62, -0.48, 1.06), (0.07, 0.0, 0.21), 31.0)
"""Both arms and the table."""
CLOSE_UP = View(ROOM.eye, (0.09, 0.0, 0.11), 23.0)
"""Hands and objects, large enough for a small picture."""


class Body(NamedTuple):
    """An object as it is to be shown: role (see ``Thing``), shape, and pose of its centre of mass in the world."""

    role: str
    spec: ObjectSpec
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class Marker(NamedTuple):
    """A thin coloured bar on the table: centre, half extents (m) and yaw (rad)."""

    x_m: float
    y_m: float
    half_x_m: float
    half_y_m: float
    yaw_rad: float
    colour: Colour


@dataclass(frozen=True, slots=True)
class Shot:
    """What a picture shows: objects, and seven joints (rad) and two fingers (m) of each acting arm, float64 (9,)."""

    joints: Mapping[str, Array]
    bodies: Sequence[Body]


def shot_of_world(
    world: World, roles: Sequence[tuple[str, ObjectSpec]], mass_offset_m: tuple[float, float] = (0.0, 0.0)
) -> Shot:
    """The present state of a simulated world; ``roles`` of its objects in the order in which they were placed.

    ``mass_offset_m`` is that of the first object's centre of mass from that of its shape.
    """
    every = (*robots.ARM_JOINTS, *robots.FINGER_JOINTS)
    joints = {
        name: np.array([state[0] for state in world.client.getJointStates(arm.body, every)])
        for name, arm in world.arms.items()
    }
    bodies: list[Body] = []
    for (role, spec), body in zip(roles, world.objects, strict=False):
        position, quaternion = world.client.getBasePositionAndOrientation(body)
        if not bodies and any(mass_offset_m):
            off = [-mass_offset_m[0], -mass_offset_m[1], 0.0]
            position, _ = world.client.multiplyTransforms(position, quaternion, off, [0.0, 0.0, 0.0, 1.0])
        bodies.append(Body(role, spec, position, quaternion))
    return Shot(joints, bodies)


def shot_of_stage(
    hands: Sequence[HandPose], things: Sequence[Thing], symmetric: bool, parameters: WorldParameters = WORLD
) -> Shot:
    """Hands and things at poses that were not simulated; ``symmetric`` as in ``kinematics.solve_path``."""
    joints = {}
    for hand in hands:
        base = base_of(hand.arm, parameters)
        x, y, z, yaw = (np.array([value]) for value in (hand.x_m, hand.y_m, hand.z_m, hand.yaw_rad))
        arm = solve_path(base, x, y, z, yaw, symmetric, parameters)[0]
        joints[hand.arm] = np.append(arm, [hand.opening_m / 2] * 2)
    return Shot(joints, [Body(role, spec, (x, y, z), about_z(yaw)) for role, spec, x, y, z, yaw in things])


def about_z(yaw_rad: float) -> tuple[float, float, float, float]:
    """Quaternion of a turn about the vertical."""
    return 0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)


class Studio:
    """Two arms at a table, to be posed and photographed in software; also a context manager."""

    def __init__(self, parameters: WorldParameters = WORLD) -> None:
        self._p = parameters
        self._world = World(("left", "right"), parameters, dressed_urdf(pybullet_data.getDataPath(), parameters))
        self._client = self._world.client
        self._extras: list[int] = []
        client = self._client
        client.removeBody(self._world.table)
        self._box((0.20, 0.0, -0.02), (0.62, 0.66, 0.02), _TABLE)
        for name in self._world.arms:
            base = base_of(name, parameters)
            self._box((base.x_m, base.y_m, base.z_m / 2), (0.10, 0.10, base.z_m / 2), _COLUMN)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._world.close()

    def picture(self, shot: Shot, markers: Sequence[Marker], size: tuple[int, int], view: View = ROOM) -> Image.Image:
        """The same as ``photograph``, with smooth edges. Needs pillow."""
        from PIL import Image

        fine = self.photograph(shot, markers, (size[0] * _OVERSAMPLING, size[1] * _OVERSAMPLING), view)
        return Image.fromarray(fine).resize(size, Image.Resampling.BOX)

    def photograph(
        self,
        shot: Shot,
        markers: Sequence[Marker] = (),
        size: tuple[int, int] = (640, 480),
        view: View = ROOM,
    ) -> npt.NDArray[np.uint8]:
        """One picture of (width, height) pixels: uint8 (height, width, 3)."""
        while self._extras:
            self._client.removeBody(self._extras.pop())
        for name in self._world.arms:
            self._pose_arm(name, shot.joints.get(name))
        for body in shot.bodies:
            colour, half_z = COLOURS[body.role], body.spec.height_m / 2
            self._extras.append(self._object(body, colour, 0.0, half_z, body.position, body.quaternion))
            self._extras.append(self._shade(body))
        for x, y, half_x, half_y, yaw, paint in markers:
            self._extras.append(self._box((x, y, 0.0008), (half_x, half_y, 0.0008), paint, about_z(yaw)))
        width, height = size
        client = self._client
        matrix = client.computeViewMatrix(view.eye, view.aim, (0, 0, 1))
        projection = client.computeProjectionMatrixFOV(view.fov_deg, width / height, 0.3, 4.0)
        _, _, colour, _, segments = client.getCameraImage(
            width,
            height,
            matrix,
            projection,
            shadow=0,
            lightDirection=(0.5, -0.6, 1.6),
            lightDistance=1.0,
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.06,
            renderer=pybullet.ER_TINY_RENDERER,
        )
        picture = np.asarray(colour, np.uint8).reshape(height, width, 4)[..., :3].copy()
        picture[np.asarray(segments).reshape(height, width) < 0] = 255
        return picture

    def _pose_arm(self, name: str, joints: Array | None) -> None:
        if joints is None:
            base = base_of(name, self._p)
            y = math.copysign(_IDLE[1], base.y_m)
            arm = solve(base, _IDLE[0], y, _IDLE[2], math.pi / 2, self._p)
            joints = np.append(arm, [0.02, 0.02])
        body = self._world.arms[name].body
        for joint, value in zip((*robots.ARM_JOINTS, *robots.FINGER_JOINTS), joints.tolist(), strict=True):
            self._client.resetJointState(body, joint, value)
        for finger in robots.FINGER_JOINTS:
            self._extras.append(self._carriage(body, finger))

    def _carriage(self, body: int, finger: int) -> int:
        """The part of a finger between its pad and the palm, which physics leaves out: nothing can touch it."""
        p = self._p
        state = self._client.getLinkState(body, finger)
        matrix = np.array(self._client.getMatrixFromQuaternion(state[5])).reshape(3, 3)
        palm = robots.FLANGE_M + robots.PALM_SIZE_M[2] - (p.tcp_offset_m - p.finger_length_m / 2)
        bottom = -p.finger_length_m / 2
        side = -1 if finger == robots.FINGER_JOINTS[0] else 1
        centre = matrix @ [0.0, side * 0.008, (palm + bottom) / 2] + state[4]
        return self._box(centre, (0.0125, 0.008, (bottom - palm) / 2), _CARRIAGE, state[5])

    def _shade(self, body: Body) -> int:
        """The shadow of an object under light from above (TinyRenderer's own lays the whole table in the dark)."""
        x, y, _ = body.position
        yaw = self._client.getEulerFromQuaternion(body.quaternion)[2]
        return self._object(body, _SHADE, 0.003, 0.0002, (x, y, 0.0004), about_z(yaw))

    def _object(
        self, body: Body, colour: Colour, rim: float, half_z: float, position: Sequence[float], turn: Sequence[float]
    ) -> int:
        parts = boxes(body.spec)
        shape = self._client.createVisualShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(parts),
            halfExtents=[[part.half_x + rim, part.half_y + rim, half_z] for part in parts],
            visualFramePositions=[[part.x, part.y, 0.0] for part in parts],
            visualFrameOrientations=[about_z(part.yaw) for part in parts],
            rgbaColors=[colour] * len(parts),
        )
        return int(self._client.createMultiBody(0, -1, shape, position, turn))

    def _box(
        self, centre: Sequence[float], half: Sequence[float], colour: Colour, quaternion: Sequence[float] = (0, 0, 0, 1)
    ) -> int:
        shape = self._client.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, rgbaColor=colour)
        return int(self._client.createMultiBody(0, -1, shape, list(centre), list(quaternion)))
