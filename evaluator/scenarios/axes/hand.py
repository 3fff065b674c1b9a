"""Another gripper than the one in the data."""

from __future__ import annotations

from evaluator.scenarios.axes.base import Axis, Draw, varied
from rema_data.schema import Scenario

__all__ = ["Hand"]


class Hand(Axis):
    """A gripper that opens less, or has wider fingers: the end-effector map shows it, as always."""

    name, number = "hand", 3
    title = "another gripper, as the end-effector map shows it (in the data: opening 110 mm, fingers 20 x 10 mm)"
    levels = ("opening 80 mm", "opening 70 mm, fingers 35 x 16 mm", "opening 62 mm")
    tasks = ("grasp",)
    _worlds = (
        {"opening_max_m": 0.080},
        {"opening_max_m": 0.070, "finger_lateral_m": 0.035, "finger_thickness_m": 0.016},
        {"opening_max_m": 0.062},
    )

    def vary(self, scenario: Scenario, level: int, draw: Draw) -> Scenario:
        return varied(scenario, world=tuple(self._worlds[level - 1].items()))
