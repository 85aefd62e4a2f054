"""A world: ground, what stands on it for good, what moves, and the static layers. Frozen; the rest is derived."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from terrafuse.errors import InputError
from terrafuse.simulate.blocks import Block
from terrafuse.simulate.houses import House, Wall, house_blocks, wall_blocks
from terrafuse.simulate.movers import Mover, all_of
from terrafuse.simulate.regions import StaticLayer, checked_layer
from terrafuse.simulate.streets import NO_STREETS, Streets
from terrafuse.simulate.terrain import Terrain
from terrafuse.types import Array, Bounds

DIFFERENTIAL, LINKED = StaticLayer(2), StaticLayer(1)
"""Differential GPS and communications everywhere."""


@dataclass(frozen=True, eq=False)
class World:
    """x east, y north, z up, metres, in the `crs` or a local frame. The terrain covers at least the bounds.

    `furniture`: whatever else stands for good, such as parked cars, as blocks in the world. Raises InputError where
    something stands off the terrain.
    """

    name: str
    bounds: Bounds
    terrain: Terrain
    houses: tuple[House, ...] = ()
    walls: tuple[Wall, ...] = ()
    furniture: tuple[Block, ...] = ()
    streets: Streets = NO_STREETS
    movers: tuple[Mover, ...] = ()
    gps_quality: StaticLayer = DIFFERENTIAL
    communications: StaticLayer = LINKED
    crs: str | None = None
    level_walls: bool = False
    """Indoors: each wall in one piece, and corners closed."""

    def __post_init__(self) -> None:
        west, south, east, north = self.terrain.bounds
        b = self.bounds
        if not (west <= b.west < b.east <= east and south <= b.south < b.north <= north):
            raise InputError(f"world {self.name}: its terrain {tuple(self.terrain.bounds)} does not cover {tuple(b)}")
        checked_layer("gps_quality", self.gps_quality)
        checked_layer("communications", self.communications)
        names = [mover.name for mover in self.movers]
        if len(set(names)) < len(names):
            raise InputError(f"world {self.name}: two movers have one name; give each its own")

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """All that stands for good: houses, walls, furniture, in this order."""
        houses = [block for house in self.houses for block in house_blocks(house, self.terrain)]
        walls = [block for wall in self.walls for block in wall_blocks(wall, self.terrain, self.level_walls)]
        return (*houses, *walls, *self.furniture)

    def bodies(self, time_s: float) -> Array:
        """(K,) BODY of what moves, as it stands on the ground at a time."""
        places = [(mover.shape, mover.route.at(time_s)) for mover in self.movers]
        there = [(shape, place) for shape, place in places if place is not None]
        x_m, y_m, yaw_rad = np.array([place for _, place in there], np.float64).reshape(-1, 3).T
        heights_m = self.terrain.height(x_m, y_m)
        return all_of([shape for shape, _ in there], np.column_stack([x_m, y_m, heights_m, yaw_rad]))


def digest(world: World) -> str:
    """A hash of all that a world is made of: the same of two worlds that are the same in every byte."""
    hasher = hashlib.blake2b(digest_size=16)
    _feed(hasher, world)
    return hasher.hexdigest()


def _feed(hasher: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        hasher.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        for field in fields(value):
            hasher.update(field.name.encode())
            _feed(hasher, getattr(value, field.name))
    elif isinstance(value, tuple):
        hasher.update(f"({len(value)}".encode())
        for item in value:
            _feed(hasher, item)
    else:
        hasher.update(repr(value).encode())
