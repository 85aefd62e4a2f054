"""A ROS map as a value."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.grids import Grid
from terrafuse.rosmap.meaning import Meaning, percent, probability
from terrafuse.types import Array, Floats

MIN_RESOLUTION_M, MAX_RESOLUTION_M = 1e-6, 1e6
MAX_ORIGIN_M = 1e9
"""Beyond all projected coordinates on Earth."""


@dataclass(frozen=True)
class Placement:
    """Where the image lies: `east_m`, `north_m` of its lower-left corner, and its turn about that corner,
    counter-clockwise. Raises InputError for numbers that no place on Earth has."""

    resolution_m: float
    east_m: float = 0.0
    north_m: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if not MIN_RESOLUTION_M <= self.resolution_m <= MAX_RESOLUTION_M:
            raise InputError(
                f"resolution {self.resolution_m}: give a positive number of metres a pixel, "
                f"{MIN_RESOLUTION_M:g} to {MAX_RESOLUTION_M:g}"
            )
        if not all(abs(value) <= MAX_ORIGIN_M for value in (self.east_m, self.north_m, self.yaw_rad)):
            raise InputError(
                f"origin [{self.east_m}, {self.north_m}, {self.yaw_rad}]: give finite numbers up to "
                f"{MAX_ORIGIN_M:g}, metres and radians"
            )


@dataclass(frozen=True, eq=False)
class RosMap:
    """`grey` (H, W), 0 to 255, uint8 (or float where an image has other depths or colours), row 0 in the north;
    `opaque` (H, W), None where all pixels are."""

    placement: Placement
    meaning: Meaning
    grey: Array
    opaque: Array | None = None

    @property
    def grid(self) -> Grid:
        place, (rows, columns) = self.placement, self.grey.shape
        r, c, s = place.resolution_m, math.cos(place.yaw_rad), math.sin(place.yaw_rad)
        north_west = place.east_m - s * r * rows, place.north_m + c * r * rows
        return Grid(rows, columns, (c * r, s * r, north_west[0], s * r, -c * r, north_west[1]))

    @property
    def probability(self) -> Floats:
        """(H, W), 0 free to 1 occupied, NaN unknown, row 0 in the north."""
        return probability(self.grey, self.meaning, self.opaque)

    @property
    def occupancy(self) -> Array:
        """The data of nav_msgs/OccupancyGrid, (H, W) int8: 0 to 100, −1 unknown, row 0 in the SOUTH, as there."""
        return np.ascontiguousarray(percent(self.probability)[::-1])
