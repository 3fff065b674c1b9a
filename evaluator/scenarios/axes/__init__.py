"""The axes of the generalisation suites: each changes one thing about a clean scenario, a little, more, and much.

An axis is a module with one class; ``AXES`` lists them. Its levels are physical quantities, settled on validation
scenarios before any test scenario was played.
"""

from __future__ import annotations

from evaluator.scenarios.axes.base import Axis, Draw
from evaluator.scenarios.axes.camera import Resolution, SenseNoise
from evaluator.scenarios.axes.clutter import Clutter
from evaluator.scenarios.axes.displaced import Act, Register
from evaluator.scenarios.axes.hand import Hand
from evaluator.scenarios.axes.mixed import Mixed
from evaluator.scenarios.axes.objects import Shapes, Sizes
from evaluator.scenarios.axes.physics import Physics
from evaluator.scenarios.axes.posts import Posts
from evaluator.scenarios.axes.tools import Tools

__all__ = ["AXES", "Axis", "Draw"]

_SINGLE: tuple[Axis, ...] = (
    Shapes(),
    Sizes(),
    Hand(),
    Tools(),
    SenseNoise(),
    Resolution(),
    Register(),
    Act(),
    Physics(),
    Clutter(),  # last of what is mixed: it keeps clear of the target as the others have made it
)
_ALL = (*_SINGLE, Mixed(_SINGLE), Posts())
AXES: dict[str, Axis] = {axis.name: axis for axis in sorted(_ALL, key=lambda axis: axis.number)}
"""Every axis by its name."""
