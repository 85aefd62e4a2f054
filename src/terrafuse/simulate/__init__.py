"""Simulated worlds with a known truth, sensors in them, and radio: another source of scans, another link.

world = village(seed=0)
caster = RayCaster(world)                                   # takes in what stands for good
bodies = world.bodies(time_s=12.0)                          # what moves, then
scan = lidar_scan(Lidar(sensor), caster, T_world_base, stamp_ns, bodies, rng)
z = truth.height(world, lattice, window)                    # what a map should say
"""

from __future__ import annotations

from terrafuse.simulate import truth
from terrafuse.simulate.blocks import Block
from terrafuse.simulate.houses import HOUSES, House, Wall
from terrafuse.simulate.movers import SHAPES, Mover, Route, bodies, body, drive
from terrafuse.simulate.rays import Hits, RayCaster
from terrafuse.simulate.regions import Region, StaticLayer
from terrafuse.simulate.sensors import Lidar, Sonar, lidar_scan, sonar_scan
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.terrain import Terrain
from terrafuse.simulate.world import World, digest
from terrafuse.simulate.worlds import WORLDS

__all__ = [
    "HOUSES", "SHAPES", "WORLDS", "Block", "Hits", "House", "Lidar", "Mover", "RayCaster", "Region", "Route", "Sonar",
    "StaticLayer", "Streets", "Terrain", "Wall", "World", "bodies", "body", "digest", "drive", "lidar_scan",
    "sonar_scan", "truth",
]  # fmt: skip
