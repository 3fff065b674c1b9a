"""A grasp as PyBullet's own examples do it: the yardstick of ``sim_throughput.py``.

Every episode resets the simulation and loads the scene from URDF files again: the plane, two iiwa arms with the meshes
that ship with PyBullet, each with a WSG-50 of PyBullet's gripper meshes, and the object. Cameras photograph the scene
(one view from above) and the hand (four views), 640 x 480 pixels each with TinyRenderer. The hand travels the full
30 cm down and up, an inverse kinematics call for every control tick. Fingers, friction, solver settings, speeds,
protective stop and success criterion are those of the world that it is compared with.
"""

from __future__ import annotations

import math
import tempfile
import xml.etree.ElementTree as ET
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pybullet
import pybullet_data

from evaluator.sim.attempt import POLL_EVERY
from evaluator.sim.kinematics import base_of
from evaluator.sim.motion import profile
from evaluator.sim.parameters import WORLD, WorldParameters
from evaluator.sim.shapes import boxes, inertia_kg_m2, mass_kg
from rema_data import grid
from rema_data.schema import Failure, Placement

ARM_JOINTS = tuple(range(7))
FLANGE_LINK = 6
FINGERS = (7, 8)
HOME_RAD = (0.0, 0.35, 0.0, -1.75, 0.0, 1.0, 0.0)
"""Above the table: where the search for a pose starts."""
PARKED_RAD = (math.pi / 2, -0.5, 0.0, -1.5, 0.0, 1.0, 0.0)
"""Turned away from the table: where the arm that does not act stands."""
WIDTH, HEIGHT = 640, 480
FLANGE_M = 0.045
"""From the frame of link 7 to the mounting face of the gripper."""
EE_VIEW_M = 0.8


@dataclass(frozen=True, slots=True)
class PlainOutcome:
    """What a grasp did: its label (None for success), the steps it took, and the lift of the object."""

    failure: Failure | None
    sim_steps: int
    lift_m: float


class PlainRecipe:
    """The plain recipe, on a client of its own.

    Parameters
    ----------
    parameters : WorldParameters
    """

    def __init__(self, parameters: WorldParameters = WORLD) -> None:
        self.parameters = parameters
        self._folder = tempfile.TemporaryDirectory(prefix="rema-plain-")
        self._urdf = Path(self._folder.name) / "arm_with_gripper.urdf"
        self._urdf.write_text(arm_urdf(parameters), encoding="utf-8")
        self._client = pybullet.connect(pybullet.DIRECT)
        self._at = {"physicsClientId": self._client}
        self._steps = 0
        self._scene: dict[str, Any] = {}

    def close(self) -> None:
        """Disconnect from Bullet."""
        pybullet.disconnect(**self._at)
        self._folder.cleanup()

    def run(self, target: Placement, action: int, arm: str) -> PlainOutcome:
        """A whole grasp episode, from an empty simulation: photographs included.

        Parameters
        ----------
        target : Placement
        action : int
            Grid index.
        arm : {"left", "right"}
            Which arm acts.
        """
        self._steps = 0
        body, arms = self._load(target)
        acting = arms[arm]
        x, y, yaw = (float(value) for value in grid.to_world(action))
        p = self.parameters
        above = (x, y, p.grasp_height_m + p.lift_height_m)
        turn = self._reach(acting, above, yaw)
        self.photograph((x, y, above[2]))
        evidence = {"lift": 0.0, "contacts": 0.0}
        failure = self._grasp(acting, body, (x, y), turn, evidence)
        return PlainOutcome(failure, self._steps, evidence["lift"])

    def _load(self, target: Placement) -> tuple[int, dict[str, int]]:
        p, at = self.parameters, self._at
        pybullet.resetSimulation(**at)
        pybullet.setGravity(0, 0, p.gravity_m_s2, **at)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=p.time_step_s,
            numSolverIterations=p.solver_iterations,
            deterministicOverlappingPairs=1,
            **at,
        )
        plane = pybullet.loadURDF(str(Path(pybullet_data.getDataPath()) / "plane.urdf"), **at)
        pybullet.changeDynamics(plane, -1, lateralFriction=p.table_friction, **at)
        arms = {name: self._load_arm(name) for name in ("left", "right")}
        spec = target.spec
        parts = boxes(spec)
        shape = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(parts),
            halfExtents=[[box.half_x, box.half_y, spec.height_m / 2] for box in parts],
            collisionFramePositions=[[box.x, box.y, 0.0] for box in parts],
            **at,
        )
        body: int = pybullet.createMultiBody(
            mass_kg(spec, p.density_kg_m3),
            shape,
            basePosition=[target.x_m, target.y_m, spec.height_m / 2],
            baseOrientation=pybullet.getQuaternionFromEuler([0, 0, target.yaw_rad]),
            **at,
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=p.object_friction,
            linearDamping=0.0,
            angularDamping=0.0,
            localInertiaDiagonal=inertia_kg_m2(spec, p.density_kg_m3),
            **at,
        )
        return body, arms

    def _load_arm(self, name: str) -> int:
        p, at, base = self.parameters, self._at, base_of(name, self.parameters)
        arm: int = pybullet.loadURDF(
            str(self._urdf),
            [base.x_m, base.y_m, base.z_m],
            pybullet.getQuaternionFromEuler([0, 0, base.yaw_rad]),
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            **at,
        )
        for finger in FINGERS:
            pybullet.changeDynamics(
                arm,
                finger,
                lateralFriction=p.finger_friction,
                spinningFriction=p.finger_spinning_friction,
                rollingFriction=0.0,
                frictionAnchor=1,
                **at,
            )
        gear = pybullet.createConstraint(
            arm, FINGERS[0], arm, FINGERS[1], pybullet.JOINT_GEAR, [1, 0, 0], [0, 0, 0], [0, 0, 0], **at
        )
        pybullet.changeConstraint(gear, gearRatio=-1, erp=p.gear_erp, maxForce=p.gear_force_n, **at)
        for joint, value in zip(ARM_JOINTS, PARKED_RAD, strict=True):
            pybullet.resetJointState(arm, joint, value, **at)
        for finger in FINGERS:
            pybullet.resetJointState(arm, finger, p.opening_max_m / 2, **at)
            pybullet.setJointMotorControl2(
                arm, finger, pybullet.POSITION_CONTROL, p.opening_max_m / 2, force=100.0, positionGain=0.5, **at
            )
        self._drive(arm, PARKED_RAD)
        return arm

    def _drive(self, arm: int, joints: Any) -> None:
        p = self.parameters
        pybullet.setJointMotorControlArray(
            arm,
            ARM_JOINTS,
            pybullet.POSITION_CONTROL,
            targetPositions=list(joints),
            forces=[p.arm_force] * 7,
            positionGains=[p.arm_gain] * 7,
            **self._at,
        )

    def _solve(self, arm: int, tip: tuple[float, float, float], yaw: float) -> Any:
        """Joints for a pose of the tool centre point, hand down: one call, from where the arm is now."""
        flange = (tip[0], tip[1], tip[2] + self.parameters.tcp_offset_m)
        return pybullet.calculateInverseKinematics(
            arm, FLANGE_LINK, flange, _hand_down(yaw), maxNumIterations=50, residualThreshold=1e-5, **self._at
        )[:7]

    def _reach(self, arm: int, tip: tuple[float, float, float], yaw: float) -> float:
        """Put the arm at rest at a pose, the way round that turns joint 7 less; returns the yaw that was taken."""
        best: tuple[float, float, Any] | None = None
        for turn in (yaw, yaw + math.pi):
            for joint, value in zip(ARM_JOINTS, HOME_RAD, strict=True):
                pybullet.resetJointState(arm, joint, value, **self._at)
            joints: Any = HOME_RAD
            for _ in range(10):
                joints = self._solve(arm, tip, turn)
                for joint, value in zip(ARM_JOINTS, joints, strict=True):
                    pybullet.resetJointState(arm, joint, value, **self._at)
            if best is None or abs(joints[6]) < best[0]:
                best = (abs(joints[6]), turn, joints)
        assert best is not None
        for joint, value in zip(ARM_JOINTS, best[2], strict=True):
            pybullet.resetJointState(arm, joint, value, **self._at)
        self._drive(arm, best[2])
        return best[1]

    def photograph(self, hand: tuple[float, float, float]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Depth images of the scene (480, 640) and of the hand (4, 480, 640)."""
        scene = self._view((0, 0, 1.0), (0, 0, 0), (0, 1, 0), 25.0)
        views = []
        for azimuth in (45, 135, 225, 315):
            a, e = math.radians(azimuth), math.radians(35)
            eye = (
                hand[0] + EE_VIEW_M * math.cos(e) * math.cos(a),
                hand[1] + EE_VIEW_M * math.cos(e) * math.sin(a),
                hand[2] + EE_VIEW_M * math.sin(e),
            )
            views.append(self._view(eye, hand, (0, 0, 1), 40.0))
        return scene, np.stack(views)

    def _view(self, eye: Any, aim: Any, up: Any, fov: float) -> npt.NDArray[Any]:
        image = pybullet.getCameraImage(
            WIDTH,
            HEIGHT,
            pybullet.computeViewMatrix(eye, aim, up),
            pybullet.computeProjectionMatrixFOV(fov, WIDTH / HEIGHT, 0.1, 2.0),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            **self._at,
        )
        return np.asarray(image[3]).reshape(HEIGHT, WIDTH)

    def _step(self, count: int) -> None:
        for _ in range(count):
            pybullet.stepSimulation(**self._at)
        self._steps += count

    def _force(self, arm: int, body: int) -> float:
        return float(sum(contact[9] for contact in pybullet.getContactPoints(arm, body, **self._at)))

    def _height(self, body: int) -> float:
        return float(pybullet.getBasePositionAndOrientation(body, **self._at)[0][2])

    def _grasp(
        self, arm: int, body: int, where: tuple[float, float], yaw: float, evidence: dict[str, float]
    ) -> Failure | None:
        """Down 30 cm, close, up 30 cm, hold; the label, or None for success."""
        p = self.parameters
        x, y = where
        low, high = p.grasp_height_m, p.grasp_height_m + p.lift_height_m
        near = 2 * self._height(body) + p.approach_clearance_m
        every, tick = p.control_every, p.time_step_s * p.control_every
        for start, end, speed in ((high, near, p.free_speed_m_s), (near, low, p.descend_speed_m_s)):
            for share in profile(start - end, speed, tick, p.ramp_share)[1:]:
                self._drive(arm, self._solve(arm, (x, y, start + (end - start) * share), yaw))
                for _ in range(every):
                    self._step(1)
                    if self._force(arm, body) > p.stop_force_n:
                        return Failure.BLOCKED

        if not self._close(arm, body, evidence):
            return Failure.NOT_LIFTED if evidence["contacts"] else Failure.MISSED

        rest = self._height(body)
        touched: deque[bool] = deque(maxlen=p.lost_steps // POLL_EVERY)
        for row, share in enumerate(profile(high - low, p.lift_speed_m_s, tick, p.ramp_share)[1:]):
            self._drive(arm, self._solve(arm, (x, y, low + (high - low) * share), yaw))
            self._step(every)
            if row % (POLL_EVERY // every) == 0:
                evidence["lift"] = max(evidence["lift"], self._height(body) - rest)
                touched.append(self._force(arm, body) > 0)
                if len(touched) == touched.maxlen and not any(touched):
                    break
        else:
            self._step(p.hold_steps)
        height = self._height(body) - rest
        evidence["lift"] = max(evidence["lift"], height)
        if height >= p.grasp_success_lift_m and self._force(arm, body) > 0:
            return None
        return Failure.SLIPPED if evidence["lift"] > p.slip_lift_m else Failure.NOT_LIFTED

    def _close(self, arm: int, body: int, evidence: dict[str, float]) -> bool:
        """Close the jaws until they stand still; whether there is something between them."""
        p, at = self.parameters, self._at
        for finger in FINGERS:
            pybullet.setJointMotorControl2(
                arm,
                finger,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=-p.finger_speed_m_s,
                force=p.finger_force_n,
                **at,
            )
        longest = int(p.opening_max_m / 2 / p.finger_speed_m_s / p.time_step_s) + 30
        still = 0
        for _ in range(longest // POLL_EVERY):
            self._step(POLL_EVERY)
            evidence["contacts"] += self._force(arm, body) > 0
            states = pybullet.getJointStates(arm, FINGERS, **at)
            still = still + 1 if max(abs(state[1]) for state in states) < p.finger_still_m_s else 0
            if still == 3:
                break
        return bool(sum(state[0] for state in pybullet.getJointStates(arm, FINGERS, **at)) >= p.empty_opening_m)


def _hand_down(yaw: float) -> Any:
    """Quaternion of link 7 with its z axis down and its -y axis, the closing axis, at a yaw."""
    c, s = math.cos(yaw), math.sin(yaw)
    # half a turn about the horizontal axis that maps y to the wanted axis: x axis (s, -c, 0), y axis (-c, -s, 0)
    angle = math.atan2(-c, s)
    return [math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0]


def arm_urdf(parameters: WorldParameters = WORLD) -> str:
    """URDF text of PyBullet's iiwa with a WSG-50 on its flange, all meshes from ``pybullet_data``.

    Joint 4 is given the range that the world's layout needs. Arm, palm and finger carriages collide as the meshes that
    they show; the fingers collide as the boxes of the world that this is compared with, so that contacts are alike.
    """
    p = parameters
    data = Path(pybullet_data.getDataPath())
    robot = ET.fromstring((data / "kuka_iiwa" / "model.urdf").read_text(encoding="utf-8"))
    for mesh in robot.iter("mesh"):
        mesh.set("filename", str(data / "kuka_iiwa" / mesh.attrib["filename"]))
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        if joint.attrib["name"].endswith("joint_4") and limit is not None:
            limit.set("lower", str(-p.joint4_limit_rad))
            limit.set("upper", str(p.joint4_limit_rad))
    flange = next(link for link in robot.findall("link") if link.attrib["name"].endswith("link_7"))
    mass = flange.find("inertial/mass")
    assert mass is not None
    mass.set("value", "1.5")  # 0.3 kg flange, 1.2 kg hand
    turn = f"0 0 {math.pi / 2}"
    meshes = data / "gripper" / "meshes"
    for kind in ("visual", "collision"):
        flange.append(_mesh(kind, f"0 0 {FLANGE_M}", turn, meshes / "WSG50_110.stl", 1.0))
    box = f"{p.finger_lateral_m} {p.finger_thickness_m} {p.finger_length_m}"
    for name, sign in (("finger1", -1), ("finger2", 1)):
        link = ET.SubElement(robot, "link", name=name)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value=str(p.finger_mass_kg))
        ET.SubElement(inertial, "inertia", ixx="5e-5", ixy="0", ixz="0", iyy="5e-5", iyz="0", izz="2e-5")
        facing = f"0 0 {sign * math.pi / 2}"
        link.append(_mesh("visual", "0 0 0", facing, meshes / "GUIDE_WSG50_110.stl", 1e-3))
        link.append(_mesh("visual", "0 0 0.023", facing, meshes / "WSG-FMF.stl", 1e-3))
        collision = ET.SubElement(link, "collision")
        height = p.tcp_offset_m - FLANGE_M - p.finger_length_m / 2
        ET.SubElement(collision, "origin", xyz=f"0 {sign * p.finger_thickness_m / 2} {height}", rpy="0 0 0")
        ET.SubElement(ET.SubElement(collision, "geometry"), "box", size=box)
        slide = ET.SubElement(robot, "joint", name=f"{name}_joint", type="prismatic")
        ET.SubElement(slide, "parent", link=flange.attrib["name"])
        ET.SubElement(slide, "child", link=name)
        ET.SubElement(slide, "origin", xyz=f"0 0 {FLANGE_M}", rpy="0 0 0")
        ET.SubElement(slide, "axis", xyz=f"0 {sign} 0")
        upper = str(p.opening_max_m / 2 + 0.002)
        ET.SubElement(slide, "limit", lower="0", upper=upper, effort="200", velocity="2")
    return ET.tostring(robot, encoding="unicode")


def _mesh(kind: str, xyz: str, rpy: str, file: Path, scale: float) -> ET.Element:
    part = ET.Element(kind)
    ET.SubElement(part, "origin", xyz=xyz, rpy=rpy)
    ET.SubElement(ET.SubElement(part, "geometry"), "mesh", filename=str(file), scale=f"{scale} {scale} {scale}")
    return part
