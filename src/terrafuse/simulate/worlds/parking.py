"""A car park: rows of bays, most of them taken, cars that come and go, people, lamps, a wall around it, two houses."""

from __future__ import annotations

import math
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from terrafuse.simulate.blocks import Block
from terrafuse.simulate.houses import House, Wall, standing
from terrafuse.simulate.movers import Mover, drive
from terrafuse.simulate.noise import Octave
from terrafuse.simulate.quantities import Seed
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.terrain import rolling
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.net import offset_loop
from terrafuse.types import Bounds

BOUNDS = Bounds(-40.0, -30.0, 40.0, 30.0)
LANES_M = (-14.0, 2.0, 18.0)
"""North of the lanes' middles; rows of bays lie on both sides."""
LANE_M, BAY_M, BAY_DEPTH_M = 6.0, 2.5, 5.0
BAYS_WEST_M, BAYS = -25.0, 20
RING_X_M = (-30.0, 30.0)
"""Where lanes join, in the west and in the east."""
GATE_M = 8.0
RIGHT_M = 1.4
"""Cars keep so far to the right of a lane's middle."""
HOUSES_PATH_M = -22.65
"""North of the path between the houses and the bays."""
TAKEN = 0.6
COMING, PASSING, PEOPLE = 6, 3, 5


class Bay(NamedTuple):
    x_m: float
    y_m: float
    lane_m: float
    """North of the lane that it lies on."""


def parking(seed: Seed = 0) -> World:
    """80 m × 60 m around the origin. In `furniture` stand the cars that stay; those that come and go are movers."""
    rng = np.random.default_rng([seed, 0])
    terrain = rolling(BOUNDS, 2.0, (Octave(120.0, 0.25),), seed)
    offset = (LANE_M + BAY_DEPTH_M) / 2
    bays = [Bay(x, lane + side * offset, lane) for lane in LANES_M for side in (-1, 1) for x in _rows()]
    order = [bays[k] for k in rng.permutation(len(bays))]
    taken, free = order[: round(TAKEN * len(bays))], order[round(TAKEN * len(bays)) :]
    still = [_car(bay, rng) for bay in taken] + _lamps()
    return World(
        "parking",
        BOUNDS,
        terrain,
        (House(20.0, -26.0, 24.0, 5.5, 6.0), House(-22.0, -26.0, 9.0, 5.5, 4.5, shape="gabled")),
        _walls(),
        tuple(standing(block, terrain) for block in still),
        _lanes(),
        tuple(_comers(free, rng) + _passers(rng) + _walkers(rng)),
    )


def _rows() -> list[float]:
    return [BAYS_WEST_M + (k + 0.5) * BAY_M for k in range(BAYS)]


def _car(bay: Bay, rng: np.random.Generator) -> Block:
    """A parked car or van, not quite straight; its height counts from the ground."""
    length, width, height = (4.4, 1.8, 1.45) if rng.uniform() < 0.8 else (4.7, 1.95, 2.2)
    x, y = bay.x_m + rng.uniform(-0.15, 0.15), bay.y_m + rng.uniform(-0.05, 0.05)
    return Block("car", x, y, length, width, math.pi / 2 + rng.uniform(-0.04, 0.04), 0.0, height, height)


def _lamps() -> list[Block]:
    rows = [(a + b) / 2 for a, b in pairwise(LANES_M)]
    return [Block("lamp", x, y, 0.25, 0.25, 0.0, 0.0, 6.0, 6.0) for y in rows for x in (-26.0, 0.0, 26.0)]


def _walls() -> tuple[Wall, ...]:
    """Around the place, with a gate in the north-western corner of its western side."""
    west, south, east, north = BOUNDS.west + 1, BOUNDS.south + 1, BOUNDS.east - 1, BOUNDS.north - 1
    gate = LANES_M[-1] - GATE_M / 2, LANES_M[-1] + GATE_M / 2
    lines = [(west, south, east, south), (east, south, east, north), (east, north, west, north)]
    lines += [(west, north, west, gate[1]), (west, gate[0], west, south)]
    return tuple(Wall(*line, 1.6, 0.25) for line in lines)


def _lanes() -> Streets:
    west, east = RING_X_M
    nodes = [(x, y) for y in LANES_M for x in (west, east)] + [(BOUNDS.west, LANES_M[-1])]
    edges = [(0, 1), (2, 3), (4, 5), (0, 2), (2, 4), (1, 3), (3, 5), (4, 6)]
    return Streets(np.array(nodes), np.array(edges), LANE_M)


def _comers(free: list[Bay], rng: np.random.Generator) -> list[Mover]:
    """Cars that come in by the gate, park in a bay for a minute or more, and leave by the gate."""
    west, gate = RING_X_M[0], LANES_M[-1]
    out = []
    for number, bay in enumerate(free[:COMING]):
        come = [(BOUNDS.west + 1.0, gate - RIGHT_M), (west - RIGHT_M, gate - RIGHT_M)]
        come += [(west - RIGHT_M, bay.lane_m - RIGHT_M), (bay.x_m, bay.lane_m - RIGHT_M), (bay.x_m, bay.y_m)]
        leave = [(bay.x_m, bay.lane_m + RIGHT_M), (west + RIGHT_M, bay.lane_m + RIGHT_M)]
        leave += [(west + RIGHT_M, gate + RIGHT_M), (BOUNDS.west + 1.0, gate + RIGHT_M)]
        start, stay = 10.0 + 25.0 * number + rng.uniform(0, 10), rng.uniform(60, 120)
        places = [place for place, _ in groupby(come + leave)]
        route = drive(places, 3.5, start, {places.index((bay.x_m, bay.y_m)): stay})
        out.append(Mover(f"comer {number}", "car", route))
    return out


def _passers(rng: np.random.Generator) -> list[Mover]:
    """Cars that come in by the gate, find nothing that they like on a way round, and leave within a minute."""
    (west, east), (south, _, north) = RING_X_M, LANES_M
    gate, corner = (BOUNDS.west + 1.0, north), (west, north)
    ring = offset_loop(np.array([gate, corner, (west, south), (east, south), (east, north), corner, gate]), RIGHT_M)
    starts = -rng.uniform(-5, 40, PASSING)
    return [Mover(f"passer {k}", "car", drive(ring, 4.0, float(s))) for k, s in enumerate(starts)]


def _walkers(rng: np.random.Generator) -> list[Mover]:
    """People who go to and fro between the houses and the nearest lane."""
    out, beside_bays = [], BAYS_WEST_M - 1.0
    for number in range(PEOPLE):
        door, turn = rng.uniform(-20, 30), rng.uniform(-20, 24)
        way = [(door, HOUSES_PATH_M), (beside_bays, HOUSES_PATH_M), (beside_bays, LANES_M[0]), (turn, LANES_M[0])]
        way += way[-2::-1]
        route = drive(way, rng.uniform(0.9, 1.6), -rng.uniform(0, 60), repeats=True)
        out.append(Mover(f"person {number}", "person", route))
    return out
