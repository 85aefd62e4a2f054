"""Small maps to export."""

from __future__ import annotations

import numpy as np

from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.base import PathPoint
from terrafuse.store.memory import MemoryStore
from terrafuse.types import Array, Pose, Scan

START_NS = 1_317_000_000 * 10**9
"""2011-09-26 01:20 UTC."""
UTM = "EPSG:32632"


def surface(east: Array, north: Array) -> Array:
    return 0.8 * np.sin(east / 3.0) + 0.3 * np.cos(north / 2.0)


def points_over(width_m: float, height_m: float, known: float = 0.7, seed: int = 0) -> Array:
    """Points on the surface, a few in each 0.1 m cell that is known, with a bare patch and a wall."""
    rng = np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(round(width_m * 10)), np.arange(round(height_m * 10)))
    cells = np.stack([i.ravel(), j.ravel()], axis=1)[rng.random(i.size) < known]
    cells = cells[(cells[:, 0] // 40 != 1) | (cells[:, 1] > 20)]
    xy = (np.repeat(cells, 2, axis=0) + rng.uniform(0.05, 0.95, (2 * len(cells), 2))) / 10
    z = surface(xy[:, 0], xy[:, 1]) + rng.normal(0, 0.01, len(xy))
    foot = np.stack([rng.uniform(1, 1.2, 900), rng.uniform(1, 3, 900), rng.uniform(0, 2, 900)], axis=1)
    return np.concatenate([np.column_stack([xy, z]), foot])


def filled(
    lattice: Lattice,
    points: Array,
    east_m: float = 0.0,
    north_m: float = 0.0,
    up_m: float = 0.0,
    robots: tuple[str, ...] = ("r1",),
) -> Replica:
    """A map of these points, shared out over the robots, shifted; each robot drove from the first point to its last."""
    store = MemoryStore(lattice, make_model("elevation"))
    for k, robot in enumerate(robots):
        mapper = Mapper(robot, lattice)
        mine = points[k :: len(robots)]
        pose = Pose.identity().shifted(east_m, north_m, up_m)
        mapper.integrate(Scan(START_NS + k * 10**9, mine, pose))
        track = [Pose.identity().shifted(east_m + p[0], north_m + p[1]) for p in mine[[0, len(mine) // 2, -1]]]
        store.accept(
            mapper.delta(), [PathPoint(START_NS + s, T_world_sensor) for s, T_world_sensor in enumerate(track)]
        )
    return Replica(store=store)
