"""A ROS map as a value."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.grids import Grid
from terrafuse.rosmap.meaning import Meaning, percent, probability
from terrafuse.types import Array, Floats


@dataclass(frozen=True)
class Placement:
    """Where the image lies: `east_m`, `north_m` of its lower-left corner, and its turn about that corner,
    counter-clockwise. Raises InputError for numbers that are not finite or a resolution that is not positive."""

    resolution_m: float
    east_m: float = 0.0
    north_m: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0):
            raise InputError(f"resolution {self.resolution_m}: give a positive number of metres a pixel")
        if not all(map(math.isfinite, (self.east_m, self.north_m, self.yaw_rad))):
            raise InputError(
                f"origin [{self.east_m}, {self.north_m}, {self.yaw_rad}]: give finite numbers, metres and radians"
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
