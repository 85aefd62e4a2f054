"""The worlds that ship: the same of one seed, on the ground, with streets that are free and lead everywhere."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.kernels.distance import squared_distance
from terrafuse.lattice import Lattice
from terrafuse.simulate import truth
from terrafuse.simulate.blocks import Block, overlap
from terrafuse.simulate.houses import HOUSES
from terrafuse.simulate.world import World, digest
from terrafuse.simulate.worlds import city, hallway, parking, soccer_field, village
from terrafuse.types import Array

MAKERS: dict[str, Callable[[int], World]] = {
    "village": lambda seed: village(seed, 400.0),
    "city": lambda seed: city(seed, 400.0),
    "parking": parking,
}
BODY_BAND = (0.1, 1.5)


@pytest.mark.parametrize("name", MAKERS)
def test_one_seed_makes_one_world(name: str) -> None:
    one, again, other = (digest(MAKERS[name](seed)) for seed in (1, 1, 2))
    assert one == again
    assert one != other


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("seed", [0, 1])
def test_what_stands_stands_on_the_ground(name: str, seed: int) -> None:
    """Its foot is below the ground everywhere under it, and the ground nowhere comes through its roof."""
    world = MAKERS[name](seed)
    lattice = Lattice(0.5, 50.0)
    window = lattice.cell_window(world.bounds)
    under = truth.ground(world, lattice, window)
    for block in world.blocks:
        alone = replace(world, houses=(), walls=(), furniture=(block,))
        part = lattice.cell_window(
            world.bounds._replace(west=block.x_m - 20, east=block.x_m + 20, south=block.y_m - 20, north=block.y_m + 20)
        )
        ground = truth.ground(world, lattice, part)
        foot = truth.footprints(alone, lattice, part, (block.kind,))
        inside = foot & np.isfinite(ground)
        if inside.any():
            assert block.bottom_m < ground[inside].min()
            assert truth.height(alone, lattice, part)[inside].min() > ground[inside].max() - 0.6
            assert block.top_m > ground[inside].max()
    assert np.isfinite(under).all()


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("seed", [0, 1])
def test_streets_are_free_and_lead_everywhere(name: str, seed: int) -> None:
    """No cell of a street is occupied, and a robot 2 m wide comes from each of them to every other on streets alone."""
    world = MAKERS[name](seed)
    lattice = Lattice(0.5, 50.0)
    window = lattice.cell_window(world.bounds)
    street = truth.streets(world, lattice, window)
    taken = truth.occupied(world, lattice, window, BODY_BAND)
    assert world.streets.connected
    assert street.sum() > 1000
    assert not (street & taken).any()
    roomy = street & (squared_distance(~street) * lattice.resolution_m**2 > 1.0)
    assert flooded(roomy).sum() == roomy.sum()


def flooded(free: Array) -> Array:
    """What can be reached from the first free cell, four-connected."""
    out = np.zeros_like(free)
    out.flat[np.flatnonzero(free)[0]] = True
    while True:
        grown = out.copy()
        grown[1:] |= out[:-1]
        grown[:-1] |= out[1:]
        grown[:, 1:] |= out[:, :-1]
        grown[:, :-1] |= out[:, 1:]
        grown &= free
        if (grown == out).all():
            return out
        out = grown


def test_the_village_is_one() -> None:
    world = village(0)
    assert tuple(world.bounds) == (-500, -500, 500, 500)
    assert {house.shape for house in world.houses} == set(HOUSES)
    heights = np.array([house.height_m for house in world.houses])
    assert 400 < len(heights) < 1500
    assert 3 <= heights.min() < 4
    assert 17 < heights.max() <= 20
    nearest = world.streets.distance(np.array([h.x_m for h in world.houses]), np.array([h.y_m for h in world.houses]))
    assert nearest.max() < 25
    assert world.walls
    assert world.furniture
    assert len(world.gps_quality.regions) == 3


def test_the_villages_streets_can_be_driven() -> None:
    """Along them the slope stays under that which the patrol paper's robots take for an obstacle (0.3) by far."""
    world = village(0)
    for x0, y0, x1, y1 in world.streets.segments_m:
        count = int(math.hypot(x1 - x0, y1 - y0) / 2) + 1
        share = np.linspace(0, 1, count + 1)
        z = world.terrain.height(x0 + share * (x1 - x0), y0 + share * (y1 - y0))
        assert np.abs(np.diff(z)).max() / (math.hypot(x1 - x0, y1 - y0) / count) < 0.2


def test_houses_do_not_stand_in_each_other() -> None:
    world = village(0, 300.0)
    blocks = {house: replace(world, houses=(house,), walls=(), furniture=()).blocks for house in world.houses}
    for one, other in combinations(world.houses, 2):
        if math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < 60:
            assert not any(overlap(a, b) for a in blocks[one] for b in blocks[other])


def test_everything_that_moves_keeps_out_of_what_stands() -> None:
    """Cars and people, over ten minutes, are nowhere within a house, a wall or a parked car."""
    for world in (village(0, 400.0), parking(0), parking(1)):
        centres = np.array([(block.x_m, block.y_m) for block in world.blocks])
        radii = np.array([math.hypot(block.length_m, block.width_m) / 2 for block in world.blocks])
        for time_s in np.arange(0, 600, 11.0):
            moving = [footprint(body) for body in world.bodies(time_s)]
            assert moving
            for body in moving:
                apart = np.hypot(*(centres - [body.x_m, body.y_m]).T) - radii
                near = np.flatnonzero(apart < math.hypot(body.length_m, body.width_m) / 2)
                assert not any(overlap(body, world.blocks[k]) for k in near), (world.name, time_s, body)


def footprint(body: Array) -> Block:
    """A body as a block; round ones as their square."""
    yaw = math.atan2(body["sin"], body["cos"])
    sides = 2 * body["half_length"], 2 * body["half_width"]
    return Block("body", body["x"], body["y"], *sides, yaw, body["bottom"], body["top"], body["top"])


def test_every_room_of_the_hallway_can_be_entered() -> None:
    """A round robot 0.45 m wide, as the *database* paper's, reaches all of the floor but what is close to walls."""
    world, lattice = hallway(), Lattice(0.05, 5.0)
    window = lattice.cell_window(world.bounds._replace(west=0.0, south=0.0, east=30.0, north=20.0))
    taken = truth.occupied(world, lattice, window, BODY_BAND)
    roomy = squared_distance(taken) * lattice.resolution_m**2 > 0.25**2
    assert flooded(roomy).sum() == roomy.sum()
    assert 0.7 < roomy.mean() < 0.9
    assert not (truth.streets(world, lattice, window) & taken).any()
    assert taken[0].all()
    assert taken[:, -1].all()


def test_the_soccer_field_is_the_papers() -> None:
    """24×36 free cells of 0.25 m, boards all around but where the goals are."""
    world, lattice = soccer_field(), Lattice(0.25, 40.0)
    assert not truth.occupied(world, lattice, (0, 0, 24, 36), (0.0, 0.4)).any()
    ring = truth.occupied(world, lattice, (-1, -1, 25, 37), (0.0, 0.4))
    assert ring[:, 0].all()
    assert ring[:, -1].all()
    # 8 cells of 2 m are open, less those at both ends that the posts reach into.
    assert (~ring[0]).sum() == (~ring[-1]).sum() == 8
    behind = truth.occupied(world, lattice, (-1, -3, 25, 39), (0.0, 0.4))
    assert behind[0, 9:17].all()


@pytest.mark.parametrize(("maker", "side"), [(village, 20.0), (village, float("nan")), (city, -5.0)])
def test_a_world_without_room_is_refused(maker: Callable[..., World], side: float) -> None:
    with pytest.raises(InputError, match="give 50 or more"):
        maker(0, side)
