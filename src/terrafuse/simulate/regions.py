"""Static layers that come with a world: a value everywhere, and other values on regions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array

ALLOWED = {"gps_quality": (0, 1, 2), "communications": (0, 1)}
"""GPS: none, single, differential. Communications: none, some."""


@dataclass(frozen=True)
class Region:
    """A value on a polygon of corners (x, y), closed by itself."""

    value: int
    ring_m: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.ring_m) < 3:
            raise InputError(f"a region of {len(self.ring_m)} corners: give at least 3")


@dataclass(frozen=True)
class StaticLayer:
    """The value of the last region in which a place lies, else the default."""

    default: int
    regions: tuple[Region, ...] = ()

    def at(self, x_m: Array | float, y_m: Array | float) -> Array:
        """uint8 of the common shape of x and y."""
        x, y = np.asarray(x_m, np.float64), np.asarray(y_m, np.float64)
        out = np.full(np.broadcast(x, y).shape, self.default, np.uint8)
        for region in self.regions:
            out[in_ring(region.ring_m, x, y)] = region.value
        return out

    def at_place(self, x_m: float, y_m: float) -> int:
        """The same of one place; a radio asks for each frame's ends, where arrays of one number would cost far more."""
        found = (region.value for region in reversed(self.regions) if _holds(region.ring_m, x_m, y_m))
        return next(found, self.default)


def checked_layer(name: str, layer: StaticLayer) -> StaticLayer:
    """The layer, if the values mean something. Raises InputError."""
    for value in (layer.default, *(region.value for region in layer.regions)):
        if value not in ALLOWED[name]:
            raise InputError(f"{name} {value}: give one of {', '.join(map(str, ALLOWED[name]))}")
    return layer


def _holds(ring_m: tuple[tuple[float, float], ...], x: float, y: float) -> bool:
    inside = False
    for (x0, y0), (x1, y1) in zip(ring_m, (*ring_m[1:], ring_m[0]), strict=True):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


def in_ring(ring_m: tuple[tuple[float, float], ...], x: Array, y: Array) -> Array:
    """Whether a line from (x, y) to the east crosses the ring an odd number of times."""
    inside = np.zeros(np.broadcast(x, y).shape, bool)
    for (x0, y0), (x1, y1) in zip(ring_m, (*ring_m[1:], ring_m[0]), strict=True):
        if y0 != y1:
            crosses = (y0 > y) != (y1 > y)
            inside ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside
