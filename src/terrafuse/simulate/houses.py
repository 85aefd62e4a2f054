"""Houses and walls: what people draw on a plan, and the blocks that they are built of."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from terrafuse.errors import InputError
from terrafuse.simulate.blocks import Block, corners_of
from terrafuse.simulate.terrain import Terrain

FOUNDATION_M = 0.5
"""How deep what stands reaches below the lowest ground under it."""
WALL_PIECE_M = 5.0
"""Walls follow the ground in steps of this length."""
ROOF_SLOPE = 0.7


@dataclass(frozen=True)
class House:
    """Its outline is a rectangle around (x, y); `height_m`: of its highest point, above the ground at its centre."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw_rad: float = 0.0
    shape: str = "box"

    def __post_init__(self) -> None:
        numbers = self.x_m, self.y_m, self.length_m, self.width_m, self.height_m, self.yaw_rad
        if not all(map(math.isfinite, numbers)) or min(self.length_m, self.width_m, self.height_m) <= 0:
            raise InputError(
                f"house at ({self.x_m}, {self.y_m}) of {self.length_m} × {self.width_m} × {self.height_m} m: "
                "give finite numbers and positive sides"
            )
        if self.shape not in HOUSES:
            raise InputError(f"house shape '{self.shape}': there are {', '.join(HOUSES)}")


@dataclass(frozen=True)
class Wall:
    """From (x0, y0) to (x1, y1); it follows the ground."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float
    height_m: float
    thickness_m: float = 0.3

    def __post_init__(self) -> None:
        if not min(self.length_m, self.height_m, self.thickness_m) > 0:
            raise InputError(
                f"wall from ({self.x0_m}, {self.y0_m}) to ({self.x1_m}, {self.y1_m}), {self.height_m} m high and "
                f"{self.thickness_m} m thick: give two different places and positive sides"
            )

    @property
    def length_m(self) -> float:
        return math.hypot(self.x1_m - self.x0_m, self.y1_m - self.y0_m)


def house_blocks(house: House, terrain: Terrain) -> tuple[Block, ...]:
    """A house as it stands on this ground. Raises InputError off the terrain."""
    ground = _ground(terrain, house.x_m, house.y_m, "a house")
    return tuple(_grounded(part, ground, terrain) for part in HOUSES[house.shape](house))


def wall_blocks(wall: Wall, terrain: Terrain, level: bool = False) -> tuple[Block, ...]:
    """A wall in pieces, each level and `height_m` above the ground at its middle; in one piece where told `level`."""
    count = 1 if level else math.ceil(wall.length_m / WALL_PIECE_M)
    dx, dy = (wall.x1_m - wall.x0_m) / count, (wall.y1_m - wall.y0_m) / count
    # Level walls join in corners: each is longer by half its thickness at both ends.
    length = wall.length_m / count + (wall.thickness_m if level else 0.0)
    out = []
    for k in range(count):
        x, y = wall.x0_m + (k + 0.5) * dx, wall.y0_m + (k + 0.5) * dy
        part = Block("wall", x, y, length, wall.thickness_m, math.atan2(dy, dx), 0.0, wall.height_m, wall.height_m)
        out.append(standing(part, terrain))
    return tuple(out)


def standing(part: Block, terrain: Terrain) -> Block:
    """A block whose heights count from the ground at its centre, as it stands in the world."""
    return _grounded(part, _ground(terrain, part.x_m, part.y_m, part.kind), terrain)


def _ground(terrain: Terrain, x_m: float, y_m: float, what: str) -> float:
    ground = float(terrain.height(x_m, y_m))
    if math.isnan(ground):
        raise InputError(f"{what} at ({x_m:g}, {y_m:g}) is off the terrain, which covers {tuple(terrain.bounds)}")
    return ground


def _grounded(part: Block, ground_m: float, terrain: Terrain) -> Block:
    """A block whose heights count from the ground, in the world; it reaches below the lowest ground at its corners."""
    lowest = float(np.fmin.reduce(terrain.height(*corners_of(part).T), initial=ground_m))
    return replace(part, bottom_m=lowest - FOUNDATION_M, eaves_m=ground_m + part.eaves_m, top_m=ground_m + part.top_m)


def _part(
    house: House,
    u: tuple[float, float],
    v: tuple[float, float],
    top_m: float,
    roof: str = "flat",
) -> Block:
    """The block over a part of the outline, -1 to 1 along and across; heights count from the ground.

    Pitched roofs are turned so that the ridge runs along the longer side.
    """
    along, across = house.length_m / 2 * np.array(u), house.width_m / 2 * np.array(v)
    c, s = math.cos(house.yaw_rad), math.sin(house.yaw_rad)
    x, y = along.mean(), across.mean()
    length, width, yaw = float(np.ptp(along)), float(np.ptp(across)), house.yaw_rad
    if width > length:
        length, width, yaw = width, length, yaw + math.pi / 2
    rise = 0.0 if roof == "flat" else min(ROOF_SLOPE * width / 2, 0.5 * top_m)
    east, north = house.x_m + float(c * x - s * y), house.y_m + float(s * x + c * y)
    return Block("house", east, north, length, width, yaw, 0.0, top_m - rise, top_m, roof)


def _box(house: House) -> tuple[Block, ...]:
    return (_part(house, (-1, 1), (-1, 1), house.height_m),)


def _l(house: House) -> tuple[Block, ...]:
    """A wing along the whole front, and a lower one behind its first half."""
    return (
        _part(house, (-1, 1), (-1, 0), house.height_m),
        _part(house, (-1, 0), (0, 1), 0.75 * house.height_m),
    )


def _gabled(house: House) -> tuple[Block, ...]:
    return (_part(house, (-1, 1), (-1, 1), house.height_m, "gable"),)


def _hipped(house: House) -> tuple[Block, ...]:
    return (_part(house, (-1, 1), (-1, 1), house.height_m, "hip"),)


def _tower(house: House) -> tuple[Block, ...]:
    """A church: a square tower under a pyramid at one end, a nave of half its height behind."""
    side = min(0.7, 0.8 * house.width_m / house.length_m)
    edge = -1 + 2 * side
    across = side * house.length_m / house.width_m
    return (
        _part(house, (-1, edge), (-across, across), house.height_m, "hip"),
        _part(house, (edge, 1), (-1, 1), 0.5 * house.height_m, "gable"),
    )


HOUSES: dict[str, Callable[[House], tuple[Block, ...]]] = {
    "box": _box,
    "l": _l,
    "gabled": _gabled,
    "hipped": _hipped,
    "tower": _tower,
}
