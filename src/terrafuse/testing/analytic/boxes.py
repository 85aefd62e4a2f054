"""Things with flat tops: boxes that stand, cars that drive and park, pits that open."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.types import Array, Floats


@dataclass(frozen=True)
class Box:
    """An upright box. Centre, sides and height in the world, metres; `yaw_rad` turns `length_m` from east to north."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    top_m: float
    yaw_rad: float = 0.0
    bottom_m: float = -1000.0
    """By default it stands in the ground, however deep that lies."""

    def covers(self, x: Array, y: Array, grown_m: float = 0.0) -> Array:
        """Which points lie in the footprint, grown (or shrunk, below 0) on all sides."""
        along, across = _turned(self, x - self.x_m, y - self.y_m)
        return np.asarray((abs(along) <= self.length_m / 2 + grown_m) & (abs(across) <= self.width_m / 2 + grown_m))


@dataclass(frozen=True)
class Car:
    """A box that drives straight from `start` to `end`, both (x, y); before and after it is not there.

    From one time to another (`parks_s`) it stands where it is; then it goes on.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    enters_s: float
    speed_m_s: float = 8.0
    parks_s: tuple[float, float] = (0.0, 0.0)
    length_m: float = 4.4
    width_m: float = 1.8
    height_m: float = 1.5
    clearance_m: float = 0.0
    """Its floor's height above the ground."""

    def place(self, time_s: float) -> tuple[float, float, float] | None:
        """(x, y, yaw) at a time, None where it is not there."""
        arrives_s, leaves_s = self.parks_s
        standing = min(max(time_s - arrives_s, 0.0), leaves_s - arrives_s)
        driven = self.speed_m_s * (time_s - self.enters_s - standing)
        east, north = self.end[0] - self.start[0], self.end[1] - self.start[1]
        share = driven / math.hypot(east, north)
        if not 0.0 <= share <= 1.0:
            return None
        return self.start[0] + share * east, self.start[1] + share * north, math.atan2(north, east)


@dataclass(frozen=True)
class Pit:
    """A hole with upright walls that is open from one time to another. `floor`'s top is the hole's bottom.

    The ground around is taken as nearly level: what goes in over one rim does not come out over the other.
    """

    floor: Box
    opens_s: float = -math.inf
    closes_s: float = math.inf


def spans(box: Box, origin: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Ranges (N,) at which rays enter and leave a box; it is missed where it is left before it is entered.

    Kay & Kajiya's slabs: `origin` (3,), `directions` (N, 3) in the world. Along a slab, a ray is in it from
    -inf to inf; beside it, it enters at inf or leaves at -inf: what dividing by zero gives.
    """
    start = _turned(box, origin[0] - box.x_m, origin[1] - box.y_m)
    along = _turned(box, directions[:, 0], directions[:, 1])
    enter, leave = np.full(len(directions), -np.inf), np.full(len(directions), np.inf)
    slabs = (
        (start[0], along[0], -box.length_m / 2, box.length_m / 2),
        (start[1], along[1], -box.width_m / 2, box.width_m / 2),
        (origin[2], directions[:, 2], box.bottom_m, box.top_m),
    )
    for at, rate, low, high in slabs:
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (low - at) / rate, (high - at) / rate
        enter = np.fmax(enter, np.fmin(one, other))
        leave = np.fmin(leave, np.fmax(one, other))
    return enter, leave


def _turned(box: Box, east: Array | float, north: Array | float) -> tuple[Array, Array]:
    """A vector of the world in the box's frame: along its length, across it."""
    c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    return np.asarray(c * east + s * north), np.asarray(c * north - s * east)
