"""Colours of objects by what they are to a step, and the names that captions give them."""

from __future__ import annotations

__all__ = ["COLOURS", "COLOUR_NAMES", "Colour"]

Colour = tuple[float, float, float, float]

COLOURS: dict[str, Colour] = {
    "target": (0.84, 0.18, 0.16, 1.0),
    "tool": (0.16, 0.42, 0.78, 1.0),
    "held": (0.55, 0.24, 0.72, 1.0),
    "other": (0.93, 0.62, 0.18, 1.0),
}
"""Of an object, by what it is to the step."""
COLOUR_NAMES = {"target": "red", "tool": "blue", "held": "purple", "other": "orange"}
