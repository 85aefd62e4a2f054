"""A village: an irregular net of streets on rolling ground, houses along them, gardens' walls, cars and people."""

from __future__ import annotations

import math

import numpy as np

from terrafuse.simulate.blocks import Block
from terrafuse.simulate.houses import Wall, standing
from terrafuse.simulate.movers import Mover, drive
from terrafuse.simulate.noise import Octave
from terrafuse.simulate.quantities import Seed
from terrafuse.simulate.regions import StaticLayer
from terrafuse.simulate.streets import Streets, graded
from terrafuse.simulate.terrain import Terrain, rolling
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.net import (
    EDGE_FREE_M,
    Net,
    Plot,
    Side,
    Sited,
    beside,
    garden_wall,
    line_streets,
    patch,
    square,
    street_net,
    tour,
)
from terrafuse.types import Bounds

NET = Net(spacing_m=140.0, jitter_m=22.0, dropped=0.15, width_m=7.0)
PLOT = Plot(
    length_m=(9.0, 19.0),
    depth_m=(8.0, 12.0),
    setback_m=(3.0, 9.0),
    gap_m=(3.0, 14.0),
    turn_rad=0.06,
    shapes={
        "gabled": (0.36, (5.0, 11.0)),
        "hipped": (0.24, (5.0, 12.0)),
        "box": (0.2, (3.0, 16.0)),
        "l": (0.17, (4.0, 9.0)),
        "tower": (0.03, (14.0, 20.0)),
    },
)
HILLS = (Octave(420.0, 4.0), Octave(170.0, 0.8))
"""What streets follow."""
BUMPS = (Octave(60.0, 0.5), Octave(22.0, 0.12))
"""What gardens and fields have besides."""
STEP_M = 2.5
LEVEL_M, BLEND_M = 7.0, 9.0
"""A street is level to its edges if all corners of the squares that it touches are."""
CARS_PER_KM2, PEOPLE_PER_KM2 = 14, 24


def village(seed: Seed = 0, side_m: Side = 1000.0) -> World:
    """A square village around the origin; the same of one seed in every byte. Every house stands at a street, every
    street leads to every other. Raises InputError for less than 50 m."""
    bounds = square(side_m)
    streets = street_net(bounds, NET, np.random.default_rng([seed, 0]))
    sited = line_streets(streets, bounds, PLOT, np.random.default_rng([seed, 1]))
    terrain = ground(bounds, streets, seed)
    walls, cars = _gardens(sited, streets, np.random.default_rng([seed, 2]))
    gps, links = _layers(bounds, np.random.default_rng([seed, 4]))
    return World(
        "village",
        bounds,
        terrain,
        tuple(one.house for one in sited),
        walls,
        tuple(standing(car, terrain) for car in cars),
        streets,
        traffic(streets, side_m, np.random.default_rng([seed, 3])),
        gps,
        links,
    )


def ground(bounds: Bounds, streets: Streets, seed: int) -> Terrain:
    """Hills under everything; bumps off the streets, which are level across and follow the hills."""
    bed = rolling(bounds, STEP_M, HILLS, seed)
    bumps = rolling(bounds, STEP_M, BUMPS, seed + 2**32)
    rough = Terrain(bed.west_m, bed.south_m, bed.step_m, bed.heights_m + bumps.heights_m)
    return graded(rough, bed, streets, LEVEL_M, BLEND_M)


def traffic(streets: Streets, side_m: float, rng: np.random.Generator) -> tuple[Mover, ...]:
    """Cars on the right, people beside the street, each to and fro on a way of its own."""
    area = (side_m / 1000) ** 2
    out = []
    for number in range(math.ceil(CARS_PER_KM2 * area)):
        way, speed = tour(streets, 8, streets.width_m / 4, rng), rng.uniform(6, 12)
        out.append(Mover(f"car {number}", "car", drive(way, speed, -rng.uniform(0, 300), repeats=True)))
    for number in range(math.ceil(PEOPLE_PER_KM2 * area)):
        way, speed = tour(streets, 3, streets.width_m / 2 + 0.4, rng), rng.uniform(0.9, 1.7)
        out.append(Mover(f"person {number}", "person", drive(way, speed, -rng.uniform(0, 900), repeats=True)))
    return tuple(out)


def _gardens(sited: list[Sited], streets: Streets, rng: np.random.Generator) -> tuple[tuple[Wall, ...], list[Block]]:
    """Before a house: a parked car where there is room, or a wall, or neither. Heights count from the ground."""
    walls, cars = [], []
    for one in sited:
        room = one.front_m - streets.width_m / 2
        has_car, has_wall, wall = rng.uniform() < 0.5, rng.uniform() < 0.5, garden_wall(one, streets, rng)
        if has_car and room > EDGE_FREE_M + 3.5:
            x, y = beside(one.at_m, one.along_rad, one.side * (one.front_m - 1.8))
            if streets.distance(x, y) > streets.width_m / 2 + EDGE_FREE_M + 2.4:
                cars.append(Block("car", x, y, 4.4, 1.8, one.along_rad, 0.0, 1.45, 1.45))
        elif has_wall and wall:
            walls.append(wall)
    return tuple(walls), cars


def _layers(bounds: Bounds, rng: np.random.Generator) -> tuple[StaticLayer, StaticLayer]:
    """Places where GPS is poor or missing, and places without a link."""
    gps = tuple(patch(value, bounds, rng) for value in (1, 1, 0))
    return StaticLayer(2, gps), StaticLayer(1, tuple(patch(0, bounds, rng) for _ in range(2)))
