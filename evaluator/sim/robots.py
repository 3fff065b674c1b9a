"""One generated URDF for both arms: an iiwa 7 with a WSG-50, for physics alone (``evaluator.render.arms`` dresses it).

Joint frames, masses and inertias are those of the iiwa description that ships with PyBullet. The hand is part of link
7, so that nothing between arm and jaws can give way; collision geometry is what can touch something: palm and fingers.
"""

from __future__ import annotations

import atexit
from contextlib import ExitStack
from functools import lru_cache
from typing import NamedTuple

from evaluator.sim.parameters import WORLD, WorldParameters
from rema_data.leftovers import temporary_folder

ARM_JOINTS = tuple(range(7))
FINGER_JOINTS = (7, 8)
PALM_LINK = 6
HALF_PI, PI = 1.57079632679, 3.14159265359


class _Link(NamedTuple):
    mass: float
    centre: str
    inertia: tuple[float, float, float]
    joint_xyz: str
    joint_rpy: str


_LINKS = (
    _Link(4.0, "0 -0.03 0.12", (0.1, 0.09, 0.02), "0 0 0.1575", "0 0 0"),
    _Link(4.0, "0.0003 0.059 0.042", (0.05, 0.018, 0.044), "0 0 0.2025", f"{HALF_PI} 0 {PI}"),
    _Link(3.0, "0 0.03 0.13", (0.08, 0.075, 0.01), "0 0.2045 0", f"{HALF_PI} 0 {PI}"),
    _Link(2.7, "0 0.067 0.034", (0.03, 0.01, 0.029), "0 0 0.2155", f"{HALF_PI} 0 0"),
    _Link(1.7, "0.0001 0.021 0.076", (0.02, 0.018, 0.005), "0 0.1845 0", f"-{HALF_PI} {PI} 0"),
    _Link(1.8, "0 0.0006 0.0004", (0.005, 0.0036, 0.0047), "0 0 0.2155", f"{HALF_PI} 0 0"),
    # Link 7 carries the body of the gripper: 0.3 kg flange plus 1.2 kg hand
    _Link(1.5, "0 0 0.06", (0.004, 0.004, 0.004), "0 0.081 0", f"-{HALF_PI} {PI} 0"),
)
PALM_SIZE_M = (0.050, 0.146, 0.0725)
FLANGE_M = 0.045
"""From the frame of link 7 to the mounting face of the gripper."""


def urdf(parameters: WorldParameters = WORLD) -> str:
    """URDF text of one arm."""
    base = '<inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
    parts = ['<?xml version="1.0"?>', '<robot name="iiwa7_wsg50">', f'<link name="base">{base}</link>']
    for number, link in enumerate(_LINKS, 1):
        ixx, iyy, izz = link.inertia
        palm = ""
        if number == 7:
            centre = f"0 0 {FLANGE_M + PALM_SIZE_M[2] / 2}"
            palm = _box(centre, PALM_SIZE_M)
        parts.append(
            f'<link name="link{number}"><inertial><origin xyz="{link.centre}"/><mass value="{link.mass}"/>'
            f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial>'
            f"{palm}</link>"
        )
        parent = "base" if number == 1 else f"link{number - 1}"
        parts.append(
            f'<joint name="joint{number}" type="revolute"><parent link="{parent}"/><child link="link{number}"/>'
            f'<origin xyz="{link.joint_xyz}" rpy="{link.joint_rpy}"/><axis xyz="0 0 1"/>'
            f'<limit lower="-3.2" upper="3.2" effort="{parameters.arm_force}" velocity="10"/>'
            f'<dynamics damping="0.5"/></joint>'
        )
    size = (parameters.finger_lateral_m, parameters.finger_thickness_m, parameters.finger_length_m)
    height = parameters.tcp_offset_m - parameters.finger_length_m / 2
    # The closing axis is -y of link 7 (kinematics.MOUNT_RAD): finger 1 opens along it, finger 2 against it; a joint's
    # value is the finger's distance from the middle
    for name, sign in (("finger1", -1), ("finger2", 1)):
        centre = f"0 {sign * parameters.finger_thickness_m / 2} 0"
        parts.append(
            f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{parameters.finger_mass_kg}"/>'
            f'<inertia ixx="5e-5" ixy="0" ixz="0" iyy="5e-5" iyz="0" izz="2e-5"/></inertial>'
            f"{_box(centre, size)}</link>"
            f'<joint name="{name}_joint" type="prismatic"><parent link="link7"/><child link="{name}"/>'
            f'<origin xyz="0 0 {height}"/><axis xyz="0 {sign} 0"/>'
            f'<limit lower="0" upper="{parameters.opening_max_m / 2 + 0.002}" effort="200" velocity="2"/></joint>'
        )
    parts.append("</robot>")
    return "\n".join(parts)


def _box(centre: str, size: tuple[float, float, float]) -> str:
    extents = " ".join(str(value) for value in size)
    return f'<collision><origin xyz="{centre}"/><geometry><box size="{extents}"/></geometry></collision>'


@lru_cache(maxsize=8)
def urdf_file(text: str) -> str:
    """Path of the URDF as a file that lives as long as the process; the next run removes that of a killed one."""
    kept = ExitStack()
    path = kept.enter_context(temporary_folder("rema-model-")) / "iiwa7_wsg50.urdf"
    path.write_text(text)
    atexit.register(kept.close)
    return str(path)
