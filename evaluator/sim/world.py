"""One PyBullet world: arms, a table, and the objects of one step.

The whole world is rebuilt at the start of each step, in a fixed order, so that what follows depends only on what is
placed. With only the objects replaced, the order of Bullet's collision pairs, and so an outcome, would depend on
earlier steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy.typing as npt
import pybullet

from evaluator.sim import robots
from evaluator.sim.kinematics import base_of
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.shapes import boxes, inertia_kg_m2, mass_kg
from evaluator.sim.staging import Thing
from rema_data.schema import ObjectSpec

Array = npt.NDArray[Any]


class Unstable(Exception):
    """The physics left its range of validity; caught by the simulator, which labels the step."""


class Client:
    """A DIRECT PyBullet connection: PyBullet's functions as methods, bound once to this connection."""

    def __init__(self) -> None:
        self.number: int = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Any:
        bound = partial(getattr(pybullet, name), physicsClientId=self.number)
        setattr(self, name, bound)
        return bound


class Arm:
    """The ``left`` or ``right`` arm with its hand inside a world: joint targets, fingers, state."""

    def __init__(self, world: World, name: str) -> None:
        self._p = world.client
        self._parameters = parameters = world.parameters
        self.base = base_of(name, parameters)
        path = robots.urdf_file(world.urdf)
        self.body: int = self._p.loadURDF(
            path,
            [self.base.x_m, self.base.y_m, self.base.z_m],
            self._p.getQuaternionFromEuler([0, 0, self.base.yaw_rad]),
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
        )
        for link in robots.FINGER_JOINTS:
            self._p.changeDynamics(
                self.body,
                link,
                lateralFriction=parameters.finger_friction,
                spinningFriction=parameters.finger_spinning_friction,
                rollingFriction=0.0,
                frictionAnchor=1,
            )
        self._p.changeDynamics(self.body, -1, linearDamping=0.0, angularDamping=0.0)
        gear = self._p.createConstraint(
            self.body,
            robots.FINGER_JOINTS[0],
            self.body,
            robots.FINGER_JOINTS[1],
            pybullet.JOINT_GEAR,
            [1, 0, 0],
            [0, 0, 0],
            [0, 0, 0],
        )
        self._p.changeConstraint(gear, gearRatio=-1, erp=parameters.gear_erp, maxForce=parameters.gear_force_n)
        self._forces = [parameters.arm_force] * 7
        self._gains = [parameters.arm_gain] * 7

    def reset(self, joints: Array, opening_m: float) -> None:
        """Put every joint at a position at rest, motors holding it; the jaws ``opening_m`` apart."""
        for joint, value in zip(robots.ARM_JOINTS, joints.tolist(), strict=True):
            self._p.resetJointState(self.body, joint, value, 0.0)
        for joint in robots.FINGER_JOINTS:
            self._p.resetJointState(self.body, joint, opening_m / 2, 0.0)
        self.follow(joints.tolist(), [0.0] * 7)
        self.hold_fingers(opening_m)

    def follow(self, joints: list[float], velocities: list[float]) -> None:
        """Set the targets of the 7 joints (rad, rad/s)."""
        self._p.setJointMotorControlArray(
            self.body,
            robots.ARM_JOINTS,
            pybullet.POSITION_CONTROL,
            targetPositions=joints,
            targetVelocities=velocities,
            forces=self._forces,
            positionGains=self._gains,
        )

    def hold_fingers(self, opening_m: float) -> None:
        """Keep the jaws ``opening_m`` apart."""
        for joint in robots.FINGER_JOINTS:
            self._p.setJointMotorControl2(
                self.body, joint, pybullet.POSITION_CONTROL, targetPosition=opening_m / 2, force=100.0, positionGain=0.5
            )

    def close_fingers(self) -> None:
        """Drive both fingers inwards at constant speed with bounded force."""
        for joint in robots.FINGER_JOINTS:
            self._p.setJointMotorControl2(
                self.body,
                joint,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=-self._parameters.finger_speed_m_s,
                force=self._parameters.finger_force_n,
            )

    def fingers(self) -> tuple[float, float]:
        """Gap between the fingers (m) and the speed of the faster one (m/s)."""
        first, second = self._p.getJointStates(self.body, robots.FINGER_JOINTS)
        return first[0] + second[0], max(abs(first[1]), abs(second[1]))

    def hand_pose(self) -> tuple[float, float, float, float]:
        """World pose of the tool centre point: x, y, z (m), yaw of the closing axis (rad)."""
        state = self._p.getLinkState(self.body, robots.PALM_LINK)
        matrix = self._p.getMatrixFromQuaternion(state[5])
        offset = self._parameters.tcp_offset_m
        x, y, z = (state[4][row] + offset * matrix[3 * row + 2] for row in range(3))
        return x, y, z, math.atan2(-matrix[4], -matrix[1])


class World:
    """A DIRECT client with a table, the named arms (``left``, ``right`` or both), and the objects of one step.

    An arm that does not act is left out: it would only cost time. ``urdf`` is by default that of ``robots.urdf``.
    """

    def __init__(self, arms: Sequence[str], parameters: WorldParameters = WORLD, urdf: str | None = None) -> None:
        self.parameters = parameters
        self.urdf = robots.urdf(parameters) if urdf is None else urdf
        self.client = Client()
        self._step = self.client.stepSimulation
        self.arms: dict[str, Arm] = {}
        self.begin(arms)

    def use(self, parameters: WorldParameters) -> None:
        """Take other constants from the next ``begin`` on."""
        if parameters != self.parameters:
            self.parameters, self.urdf = parameters, robots.urdf(parameters)

    def begin(self, arms: Sequence[str] | None = None) -> None:
        """Build everything again: an empty table, and arms (by default those of before) for the caller to reset."""
        p, parameters = self.client, self.parameters
        names = tuple(self.arms) if arms is None else tuple(arms)
        self.steps = 0
        p.resetSimulation()
        p.setGravity(0, 0, parameters.gravity_m_s2)
        p.setPhysicsEngineParameter(
            fixedTimeStep=parameters.time_step_s,
            numSolverIterations=parameters.solver_iterations,
            deterministicOverlappingPairs=1,
        )
        plane = p.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=[0, 0, 1])
        # any visual shape keeps Bullet from tessellating the plane for its renderer, which takes longer than the rest
        mark = p.createVisualShape(pybullet.GEOM_BOX, halfExtents=[0.01, 0.01, 0.0001])
        self.table: int = p.createMultiBody(0, plane, mark)
        p.changeDynamics(self.table, -1, lateralFriction=parameters.table_friction)
        self.arms = {name: Arm(self, name) for name in names}

    def place(
        self,
        spec: ObjectSpec,
        x_m: float,
        y_m: float,
        z_m: float,
        yaw_rad: float,
        *,
        fixed: bool = False,
        mass_offset_m: tuple[float, float] = (0.0, 0.0),
    ) -> int:
        """Put an object at a pose, at rest; returns its body id.

        The pose is that of its centre of mass, which lies at ``mass_offset_m`` in the frame of the object's shape. A
        ``fixed`` object never moves.
        """
        p, parameters = self.client, self.parameters
        parts = boxes(spec)
        off_x, off_y = mass_offset_m
        turned = {}
        if any(box.yaw for box in parts):
            turned["collisionFrameOrientations"] = [
                [0.0, 0.0, math.sin(box.yaw / 2), math.cos(box.yaw / 2)] for box in parts
            ]
        shape = p.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(parts),
            halfExtents=[[box.half_x, box.half_y, spec.height_m / 2] for box in parts],
            collisionFramePositions=[[box.x - off_x, box.y - off_y, 0.0] for box in parts],
            **turned,
        )
        half = yaw_rad / 2
        mass = 0.0 if fixed else mass_kg(spec, parameters.density_kg_m3)
        body: int = p.createMultiBody(
            mass,
            shape,
            basePosition=[x_m, y_m, z_m],
            baseOrientation=[0.0, 0.0, math.sin(half), math.cos(half)],
            useMaximalCoordinates=1,
        )
        if fixed:
            p.changeDynamics(body, -1, lateralFriction=parameters.object_friction)
            return body
        p.changeDynamics(
            body,
            -1,
            lateralFriction=parameters.object_friction,
            linearDamping=0.0,
            angularDamping=0.0,
            mass=mass,  # an inertia without its mass gives NaN for a body in maximal coordinates
            localInertiaDiagonal=inertia_kg_m2(spec, parameters.density_kg_m3),
        )
        return body

    def put(self, thing: Thing) -> int:
        """Place a thing where it is staged; returns its body id."""
        return self.place(*thing[1:])

    @property
    def objects(self) -> tuple[int, ...]:
        """Bodies of the objects, in the order in which they were placed."""
        count = self.client.getNumBodies()
        return tuple(self.client.getBodyUniqueId(n) for n in range(1 + len(self.arms), count))  # table and arms first

    def step(self, count: int = 1) -> None:
        """Advance the simulation by ``count`` steps."""
        for _ in range(count):
            self._step()
        self.steps += count

    def pose(self, body: int) -> tuple[float, float, float, float]:
        """World pose of an object: x, y, z of its centre of mass (m), yaw (rad)."""
        (x, y, z), q = self.client.getBasePositionAndOrientation(body)
        yaw = math.atan2(2 * (q[3] * q[2] + q[0] * q[1]), 1 - 2 * (q[1] ** 2 + q[2] ** 2))
        return x, y, z, yaw

    def tilt(self, body: int) -> float:
        """Angle between an object's z axis and the vertical, radians."""
        _, q = self.client.getBasePositionAndOrientation(body)
        return math.acos(max(-1.0, min(1.0, 1 - 2 * (q[0] ** 2 + q[1] ** 2))))

    def speed(self, body: int) -> float:
        """Speed of an object's centre of mass plus 5 cm times its spin, m/s."""
        linear, angular = self.client.getBaseVelocity(body)
        return math.hypot(*linear) + 0.05 * math.hypot(*angular)

    def force(self, body: int, other: int) -> float:
        """Total normal force between two bodies in the last step, N."""
        total = 0.0
        for contact in self.client.getContactPoints(body, other):
            total += contact[9]
        return total

    def touching(self, body: int, other: int) -> bool:
        """Whether two bodies pressed on each other in the last step."""
        # a plain loop is quicker, and this runs after every simulation step
        for contact in self.client.getContactPoints(body, other):  # noqa: SIM110
            if contact[9] > 0:
                return True
        return False

    def check(self, *bodies: int) -> None:
        """Raise Unstable if an object flies, sinks or is not a number."""
        for body in bodies:
            x, y, z, _ = self.pose(body)
            far = max(abs(x), abs(y), abs(z))
            # a comparison with NaN is false, so the test is written to fail on it
            if not (far < self.parameters.max_distance_m and self.speed(body) < self.parameters.max_speed_m_s):
                raise Unstable

    def close(self) -> None:
        """Disconnect the client."""
        self.client.disconnect()
