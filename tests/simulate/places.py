"""Small worlds that tests share."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from terrafuse.simulate.houses import HOUSES, House, Wall
from terrafuse.simulate.noise import Octave
from terrafuse.simulate.terrain import flat, rolling
from terrafuse.simulate.world import World
from terrafuse.types import Bounds, Floats

BOUNDS = Bounds(-40.0, -40.0, 40.0, 40.0)
CENTRES = ((-20.0, -20.0), (0.0, -18.0), (20.0, -20.0), (-20.0, 15.0), (15.0, 15.0))


def hamlet(east_m: float = 0.0, north_m: float = 0.0) -> World:
    """A house of each shape, turned differently, and two walls on hills; moved by so much."""
    x, y = east_m, north_m
    bounds = Bounds(*(edge + shift for edge, shift in zip(BOUNDS, (x, y, x, y), strict=True)))
    terrain = rolling(bounds, 4.0, (Octave(60.0, 2.0),), seed=1)
    houses = tuple(
        House(x + cx, y + cy, 12.0, 8.0, 9.0, 0.3 * k, shape)
        for k, ((cx, cy), shape) in enumerate(zip(CENTRES, HOUSES, strict=True))
    )
    walls = (Wall(x - 30, y, x + 30, y + 3, 1.5), Wall(x + 35, y - 30, x + 35, y + 30, 2.0))
    return World("hamlet", bounds, terrain, houses, walls)


def room(side_m: float = 4.0, height_m: float = 2.5) -> World:
    """A square room around the origin whose walls' inner faces are half a side away; level ground at 0."""
    h = side_m / 2 + 0.1
    corners = [(-h, -h), (h, -h), (h, h), (-h, h), (-h, -h)]
    walls = tuple(Wall(*a, *b, height_m, 0.2) for a, b in pairwise(corners))
    bounds = Bounds(-h - 5, -h - 5, h + 5, h + 5)
    return World("room", bounds, flat(bounds), walls=walls, level_walls=True)


def directions(rng: np.random.Generator, count: int) -> Floats:
    """Evenly over the sphere."""
    out = rng.normal(size=(count, 3))
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def places(rng: np.random.Generator, world: World, count: int, z_m: tuple[float, float]) -> Floats:
    """Evenly over a world without its rim, (count, 3)."""
    west, south, east, north = world.bounds
    low, high = (west + 1, south + 1, z_m[0]), (east - 1, north - 1, z_m[1])
    return rng.uniform(low, high, (count, 3))
