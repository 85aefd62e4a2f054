"""python -m bench.rays [--json FILE] [--rounds N]: ray traversal and the occupancy mapper on one thread.

The stream: a lidar of 1080 beams (270°, 30 m) drives through a hall with pillars and walls, 5 cm cells. With
TERRAFUSE_RECORDINGS also a real log. OctoMap takes part if `pyoctomap` is installed: the same points into a plane of
voxels. Sonars are in bench.sonar.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import parser, tell
from terrafuse.kernels.rays import trace_reference
from terrafuse.kernels.traced import Tracer
from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.types import Beam, Floats, Pose, Scan

Works = list[Callable[[], object]]
"""A job, scan by scan."""

LATTICE = Lattice(0.05)
LIDAR = Beam(max_range_m=30.0)
LOG = "lidar2d/ple_corrected/freiburg-079-corrected.log.gz"
REFERENCE_RAYS = 100
SCAN_NS = 25_000_000


def hall() -> Floats:
    """(K, 4) walls x0 y0 x1 y1: a hall of 60×30 m with pillars and a few partitions."""
    rng = np.random.default_rng(3)
    walls = [(0, 0, 60, 0), (60, 0, 60, 30), (60, 30, 0, 30), (0, 30, 0, 0)]
    for x in np.arange(5, 60, 7.5):
        for y in (6.0, 24.0):
            corners = np.array([(x, y), (x + 0.6, y), (x + 0.6, y + 0.6), (x, y + 0.6)])
            walls += [(*a, *b) for a, b in zip(corners, np.roll(corners, 1, axis=0), strict=True)]
    for x in rng.uniform(5, 55, 5):
        walls.append((x, 27.0, x + rng.uniform(-2, 2), 30.0))
    return np.array(walls, np.float64)


def ranges(x: float, y: float, bearings: Floats, walls: Floats) -> Floats:
    """How far it is from (x, y) to the first wall in each direction."""
    ux, uy = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
    ax, ay, bx, by = (walls[None, :, k] for k in range(4))
    sx, sy = bx - ax, by - ay
    cross = ux * sy - uy * sx
    with np.errstate(divide="ignore", invalid="ignore"):
        along = ((ax - x) * sy - (ay - y) * sx) / cross
        across = ((ax - x) * uy - (ay - y) * ux) / cross
    along[~((along > 0) & (across >= 0) & (across <= 1))] = np.inf
    return np.asarray(along.min(axis=1))


def drive(count: int, beams: int, fov_rad: float) -> list[Scan]:
    """Scans along the hall, 25 cm apart; readings beyond the sensor's reach are misses."""
    rng, walls = np.random.default_rng(0), hall()
    out = []
    for k in range(count):
        x, y, yaw = 3 + 0.25 * k % 54, 15 + 5 * np.sin(k / 15), 0.5 * np.cos(k / 15)
        angles = np.linspace(-fov_rad / 2, fov_rad / 2, beams)
        read = ranges(x, y, yaw + angles, walls) + rng.normal(0, 0.01, beams)
        ends = np.minimum(read, LIDAR.max_range_m)[:, None] * np.column_stack(
            [np.cos(angles), np.sin(angles), 0 * angles]
        )
        pose = Pose.from_quaternion((x, y, 0.3), (0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))
        seen = read < LIDAR.max_range_m
        out.append(Scan(k * SCAN_NS, ends[seen], pose, ends[~seen], beam=LIDAR))
    return out


def segments(scan: Scan) -> tuple[Floats, Any]:
    """(x0 y0 x1 y1, whether it hits) of each beam, in world metres."""
    T = scan.T_world_sensor.matrix
    assert scan.misses is not None
    ends = np.concatenate([scan.points, scan.misses]) @ T[:2, :3].T + T[:2, 3]
    marks = np.arange(len(ends)) < len(scan.points)
    return np.column_stack([np.broadcast_to(T[:2, 3], ends.shape), ends]), marks


def crossings(ends: Floats, cells_per_m: float) -> int:
    """How many cells rays cross, each ray by itself."""
    alone, no = Tracer(cells_per_m, LATTICE.tile_cells), np.zeros(1, bool)
    return sum(alone(ray[None], no).cells for ray in ends)


def mapper_of(scans: list[Scan], lattice: Lattice) -> Works:
    """The whole robot on these scans, over a map that is there already."""
    mapper = Mapper("r1", lattice, make_model("occupancy"))
    works = [partial(mapper.integrate, scan) for scan in scans]
    for work in works:
        work()
    return works


def octomap(scans: list[Scan], resolution_m: float) -> Works:
    """OctoMap's insertion of the same points into voxels of the same side; nothing without pyoctomap."""
    try:
        import pyoctomap
    except ImportError:
        return []
    tree = pyoctomap.OcTree(resolution_m)
    works = []
    for scan in scans:
        T = scan.T_world_sensor.matrix
        points = np.ascontiguousarray(scan.points @ T[:3, :3].T + T[:3, 3])
        works.append(partial(tree.insertPointCloud, points, T[:3, 3].copy()))
    return works


def interleaved(jobs: dict[str, Works], rounds: int) -> dict[str, float]:
    """Seconds of each job: the least of several rounds of each scan by itself, jobs in turn.

    What else runs on the machine only ever adds, and a slow spell of it hits all alike.
    """
    least = {name: np.full(len(works), np.inf) for name, works in jobs.items()}
    for _ in range(rounds):
        for name, works in jobs.items():
            for k, work in enumerate(works):
                started = time.perf_counter()
                work()
                least[name][k] = min(least[name][k], time.perf_counter() - started)
    return {name: float(times.sum()) for name, times in least.items()}


def real_log() -> list[Scan]:
    if "TERRAFUSE_RECORDINGS" not in os.environ:
        return []
    path = Path(os.environ["TERRAFUSE_RECORDINGS"]) / LOG
    return [record for record in open_log(str(path)).scans() if isinstance(record, Scan)]


def measure(rounds: int) -> dict[str, Any]:
    lidar = drive(100, 1080, np.deg2rad(270))
    log = real_log()
    cells_per_m = LATTICE.cells_per_m
    rays = [segments(scan) for scan in lidar]
    crossed = sum(crossings(ends, cells_per_m) for ends, _ in rays)
    few = rays[0][0][:: len(rays[0][0]) // REFERENCE_RAYS], rays[0][1][:: len(rays[0][1]) // REFERENCE_RAYS]
    tracer, observe = Tracer(cells_per_m, LATTICE.tile_cells), make_model("occupancy").observer(LATTICE)
    jobs: dict[str, Works] = {
        "rays": [partial(tracer, ends, marks) for ends, marks in rays],
        "rays to a patch": [partial(observe, scan) for scan in lidar],
        "mapper": mapper_of(lidar, LATTICE),
        "reference": [partial(trace_reference, *few, cells_per_m)],
        "real log": mapper_of(log, Lattice(0.1)),
        "octomap": octomap(lidar, LATTICE.resolution_m),
    }
    jobs = {name: works for name, works in jobs.items() if works}
    seconds = interleaved(jobs, rounds)
    cells: dict[str, int] = {name: crossed for name in ("rays", "rays to a patch", "mapper", "octomap") if name in jobs}
    cells["reference"] = crossings(few[0], cells_per_m)
    out: dict[str, Any] = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "stream": {"scans": len(lidar), "beams": sum(len(ends) for ends, _ in rays), "cells crossed": crossed},
        "million_cells_per_second": {name: count / seconds[name] / 1e6 for name, count in cells.items()},
        "lidar_scans_per_second": {name: len(lidar) / seconds[name] for name in ("mapper", "octomap") if name in jobs},
    }
    if log:
        out["real_log"] = {"log": LOG, "scans": len(log), "scans_per_second": len(log) / seconds["real log"]}
    return out


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--rounds", type=int, default=5)
    arguments = arguments_of.parse_args()
    tell(measure(arguments.rounds), arguments.json)


if __name__ == "__main__":
    main()
