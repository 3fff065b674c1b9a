"""Rectangles in the plane: footprints, distances and rasters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from rema_data.grid import PIXEL_M, pixel_centres


class Rect(NamedTuple):
    """A rectangle: centre, yaw of its x axis, half extents; metres and radians."""

    x: float
    y: float
    yaw: float
    half_x: float
    half_y: float

    def moved(self, x: float, y: float, yaw: float) -> Rect:
        """This rectangle of a body frame, seen from the frame in which the body is at (x, y, yaw)."""
        c, s = math.cos(yaw), math.sin(yaw)
        return Rect(x + c * self.x - s * self.y, y + s * self.x + c * self.y, yaw + self.yaw, self.half_x, self.half_y)

    def extent(self, direction: float) -> tuple[float, float]:
        """Smallest and largest coordinate of the rectangle along ``direction`` (rad)."""
        centre = self.x * math.cos(direction) + self.y * math.sin(direction)
        delta = direction - self.yaw
        reach = self.half_x * abs(math.cos(delta)) + self.half_y * abs(math.sin(delta))
        return centre - reach, centre + reach


def swept(rect: Rect, way_m: float) -> Rect:
    """A rectangle along the axes that covers ``rect`` on its way along x."""
    (x_low, x_high), (y_low, y_high) = rect.extent(0.0), rect.extent(math.pi / 2)
    x_low, x_high = x_low + min(0.0, way_m), x_high + max(0.0, way_m)
    return Rect((x_low + x_high) / 2, (y_low + y_high) / 2, 0.0, (x_high - x_low) / 2, (y_high - y_low) / 2)


def separation(a: Rect, b: Rect) -> float:
    """A lower bound of the distance between two rectangles; negative where they overlap (separating axes)."""
    dx, dy = b.x - a.x, b.y - a.y
    turn = b.yaw - a.yaw
    c, s = abs(math.cos(turn)), abs(math.sin(turn))
    ca, sa, cb, sb = math.cos(a.yaw), math.sin(a.yaw), math.cos(b.yaw), math.sin(b.yaw)
    return max(
        abs(dx * ca + dy * sa) - a.half_x - b.half_x * c - b.half_y * s,
        abs(dy * ca - dx * sa) - a.half_y - b.half_x * s - b.half_y * c,
        abs(dx * cb + dy * sb) - b.half_x - a.half_x * c - a.half_y * s,
        abs(dy * cb - dx * sb) - b.half_y - a.half_x * s - a.half_y * c,
    )


def gap(first: Iterable[Rect], second: Sequence[Rect]) -> float:
    """A lower bound of the distance between two sets of rectangles."""
    return min(separation(a, b) for a in first for b in second)


def paint(image: npt.NDArray[Any], rect: Rect, value: float, half_m: float) -> None:
    """Set the pixels whose centres lie inside ``rect`` to at least ``value``, in place.

    ``image`` (n, n) is centred on the frame's origin, rows along y, columns along x; its edge is 2 ``half_m`` metres.
    """
    pixels = image.shape[0]
    x_low, x_high = rect.extent(0.0)
    y_low, y_high = rect.extent(math.pi / 2)
    columns = slice(*_pixel_range(x_low, x_high, half_m, pixels))
    rows = slice(*_pixel_range(y_low, y_high, half_m, pixels))
    centres = pixel_centres(pixels)
    x, y = centres[columns] - rect.x, (centres[rows] - rect.y)[:, None]
    c, s = math.cos(rect.yaw), math.sin(rect.yaw)
    inside = (np.abs(c * x + s * y) <= rect.half_x) & (np.abs(c * y - s * x) <= rect.half_y)
    window = image[rows, columns]
    np.maximum(window, value, out=window, where=inside, casting="unsafe")


def _pixel_range(low: float, high: float, half_m: float, pixels: int) -> tuple[int, int]:
    first = math.floor((low + half_m) / PIXEL_M)
    last = math.ceil((high + half_m) / PIXEL_M)
    return min(max(first, 0), pixels), min(max(last, 0), pixels)
