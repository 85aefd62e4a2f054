"""python -m bench.simulate_rays [--json FILE] [--rounds N]: casting rays at the village, on one thread.

Robots with lidars of 16 rings × 900 azimuths stand on crossings; each scan's rays are cast with what moves there and
with two other robots. Also: whole scans (rays, noise, points), and how long the world takes to make and to take in.
Ratios to real time are of three robots at 10 Hz.

Times are the thread's own (processor time), so that others on the machine count less; of each place the least of
several rounds counts.
"""

from __future__ import annotations

import math
import platform
import time
from typing import Any

import numpy as np

from bench.report import parser, tell
from terrafuse.sense import Ring, Sensor
from terrafuse.sense.sensor import Mounting, axes
from terrafuse.simulate.movers import bodies, body
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.sensors.lidar import Lidar, lidar_scan
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.village import village
from terrafuse.types import Array, Floats, Pose

ROBOTS, RATE_HZ, REACH_M = 3, 10, 100.0
RING = Ring(900, 0.0, math.radians(0.4), elevations_rad=tuple(np.radians(np.linspace(-15, 15, 16))))
SENSOR = Sensor("16 × 900", REACH_M, beams=RING, noise_sigma_m=0.02, mounting=Mounting(z_m=0.9))
PLACES = 20


def poses(world: World) -> list[Pose]:
    """T_world_base of robots on crossings, spread over the village."""
    nodes = world.streets.nodes_m[:: max(1, len(world.streets.nodes_m) // PLACES)]
    heights = world.terrain.height(*nodes.T)
    return [Pose.from_quaternion((x, y, z), (0, 0, 0, 1)) for (x, y), z in zip(nodes, heights, strict=True)]


def interleaved(jobs: dict[str, Any], rounds: int) -> dict[str, float]:
    """Seconds of each: the mean over the places of the least of several rounds."""
    least = {name: np.full(len(items), np.inf) for name, (_, items) in jobs.items()}
    for _ in range(rounds):
        for name, (work, items) in jobs.items():
            for k, item in enumerate(items):
                least[name][k] = min(least[name][k], timed(lambda item=item, work=work: work(item))[1])
    return {name: float(times.mean()) for name, times in least.items()}


def timed(work: Any) -> tuple[Any, float]:
    started = time.thread_time()
    out = work()
    return out, time.thread_time() - started


def measure(rounds: int) -> dict[str, Any]:
    world, made_s = timed(lambda: village(0))
    caster, taken_s = timed(lambda: RayCaster(world))
    moving = bodies([world.bodies(0.0), *(body("summit_xl", *p.position, 0.0) for p in poses(world)[1:3])])
    directions, _ = axes(SENSOR.beams)
    lidar, rng = Lidar(SENSOR), np.random.default_rng(0)
    places = poses(world)

    above = np.array([0.0, 0.0, 0.9])

    def cast(T_world_base: Pose, reach_m: float = REACH_M) -> tuple[Floats, Array]:
        hits = caster.cast(T_world_base.position + above, directions, reach_m, moving)
        return hits.ranges_m, hits.normals

    seconds = interleaved(
        {
            "cast": (cast, places),
            "scan": (lambda T: lidar_scan(lidar, caster, T, 0, moving, rng), places),
        },
        rounds,
    )
    rays = len(directions)
    hit = np.mean([np.isfinite(cast(T)[0]).mean() for T in places])
    return {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "village": {"houses": len(world.houses), "blocks": len(world.blocks), "movers": len(world.movers)},
        "seconds_to_make": made_s,
        "seconds_to_take_in": taken_s,
        "rays_a_scan": rays,
        "share_of_rays_that_hit": float(hit),
        "million_rays_per_second": {name: rays / s / 1e6 for name, s in seconds.items()},
        "times_real_time": {name: 1 / (ROBOTS * RATE_HZ * s) for name, s in seconds.items()},
    }


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--rounds", type=int, default=10)
    arguments = arguments_of.parse_args()
    tell(measure(arguments.rounds), arguments.json)


if __name__ == "__main__":
    main()
