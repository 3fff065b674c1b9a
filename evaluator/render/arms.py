"""Arms to look at: the URDF of the world with the meshes and colours of the real arm. Physics stays the same."""

from __future__ import annotations

from copy import deepcopy
from xml.etree import ElementTree

from evaluator.sim import robots
from evaluator.sim.parameters import WORLD, WorldParameters

__all__ = ["dressed_urdf"]

_ORANGE, _GREY = "0.95 0.55 0.15 1", "0.62 0.65 0.68 1"
_PALM, _FINGER = "0.75 0.75 0.78 1", "0.25 0.25 0.28 1"
_ORANGE_LINKS = (0, 3, 5)


def dressed_urdf(meshes: str, parameters: WorldParameters = WORLD) -> str:
    """URDF text of one arm that can be photographed; ``meshes`` is the folder of pybullet_data."""
    robot = ElementTree.fromstring(robots.urdf(parameters))
    for number, link in enumerate(robot.findall("link")):
        if number < 8:  # the base and the seven links of the arm; then the fingers
            colour = _ORANGE if number in _ORANGE_LINKS else _GREY
            visual = _visual(link, f"m{number}", colour)
            mesh = {"filename": f"{meshes}/kuka_iiwa/meshes/link_{number}.obj"}
            ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), "mesh", mesh)
        for collision in link.findall("collision"):
            colour = _PALM if number < 8 else _FINGER
            _visual(link, colour, colour).extend(deepcopy(list(collision)))
    return ElementTree.tostring(robot, encoding="unicode")


def _visual(link: ElementTree.Element, name: str, colour: str) -> ElementTree.Element:
    visual = ElementTree.SubElement(link, "visual")
    material = ElementTree.SubElement(visual, "material", {"name": name})
    ElementTree.SubElement(material, "color", {"rgba": colour})
    return visual
