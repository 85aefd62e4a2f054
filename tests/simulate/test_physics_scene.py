"""The world in the physics engine is the world of rays and truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from terrafuse.simulate.blocks import top_at
from terrafuse.simulate.motion import BODIES
from terrafuse.simulate.movers import SHAPES
from terrafuse.simulate.physics import MACHINES
from terrafuse.simulate.physics.scene import add_world, origin_of
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds import village
from terrafuse.types import Floats
from tests.simulate.places import hamlet, room

mujoco = pytest.importorskip("mujoco")


def looked_down(world: World, places_m: Floats) -> Floats:
    """z of what a ray straight down meets in the engine."""
    spec, origin_m = mujoco.MjSpec(), origin_of(world)
    add_world(spec, world, origin_m)
    model = spec.compile()
    data: Any = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    starts = np.column_stack([places_m, np.full(len(places_m), 300.0)]) - origin_m
    return np.array([300.0 - mujoco.mj_ray(model, data, start, down, None, 1, -1, geom) for start in starts])


def tops(world: World, places_m: Floats) -> Floats:
    heights = [world.terrain.height(*places_m.T), *(top_at(block, *places_m.T) for block in world.blocks)]
    return np.asarray(np.max(heights, axis=0))


@pytest.mark.parametrize(
    "world", [hamlet(), hamlet(500_000.0, 4_500_000.0), room(), village(0, 150)], ids=lambda w: w.name
)
def test_ground_roofs_and_walls_are_where_truth_has_them(world: World) -> None:
    """To 2 µm: heights are float32 shares of their range, and corners of roofs float32 metres from their middle."""
    west, south, east, north = world.bounds
    places = np.random.default_rng(0).uniform((west, south), (east, north), (2000, 2))
    assert looked_down(world, places) == pytest.approx(tops(world, places), abs=2e-6)


def test_hulls_are_not_larger_than_what_rays_see() -> None:
    assert set(MACHINES) == set(BODIES) <= set(SHAPES)
    for name, machine in MACHINES.items():
        (seen,) = SHAPES[name]
        hull = machine.hull
        assert (hull.length_m, hull.width_m, hull.top_m, hull.round) == (
            seen.length_m, seen.width_m, seen.top_m, seen.round,
        )  # fmt: skip
