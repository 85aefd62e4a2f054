"""python -m bench.patrol [--json FILE] [--scans N] [--rounds N]

The *patrol* paper's pipeline, stage by stage as in its table 2: 100,000 points of a 3D lidar, a local map (HRM) of
320×320 cells of 0.5 m, a global one (GLRM) of 200×200 cells of 5 m. The compiled kernels and the NumPy references take
the same scans in turn, a round of all scans each, so that a slow spell of the machine hits both; times are the least of
the rounds, in milliseconds.

What a stage holds: the point list, the transform of all points and their cells; heights, the sums of each cell and its
plane, whose slopes are gradients, too; gradients, the neighbours' differences where there is no plane.
"""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bench.report import parser, tell
from bench.stream import scene
from terrafuse.kernels import (
    rasterise,
    terrain,
    terrain_coarsen,
    terrain_fuse,
    terrain_merge,
    terrain_planes,
    terrain_points,
)
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models.terrain import Terrain
from terrafuse.simulate.mission.studies.village import STAGES_OF_PAPER
from terrafuse.testing.analytic.scene import Lidar, scan
from terrafuse.tile import opaque
from terrafuse.types import Array, Pose, Scan

POINTS = 100_000
RANGE_M = 75.0
HRM, FACTOR, GLRM_SIDE = Lattice(0.5, 160.0), 10, 200
SIDE = HRM.tile_cells
MODEL = Terrain(max_range_m=RANGE_M)
SHAPE = MODEL.shape(HRM.resolution_m)
FINE, COARSE = MODEL.rules(HRM.resolution_m), MODEL.rules(HRM.resolution_m * FACTOR)
ACROSS = math.isqrt(MODEL.subcells)

POINT_LIST, HEIGHTS, GRADIENTS, CONFIDENCE, OCCUPATION, INTO_HRM, INTO_LLRM, INTO_GLRM = STAGES_OF_PAPER


class Clock:
    """The least time of each stage of each scan."""

    def __init__(self) -> None:
        self.seconds: dict[tuple[str, int], float] = {}
        self.scan = 0

    def time(self, stage: str, work: Callable[..., Any], *arguments: Any) -> Any:
        started = time.perf_counter()
        result = work(*arguments)
        spent = time.perf_counter() - started
        self.seconds[stage, self.scan] = min(spent, self.seconds.get((stage, self.scan), math.inf))
        return result

    def milliseconds(self) -> dict[str, float]:
        """Of each stage, the mean over the scans."""
        count = self.scan + 1
        out: dict[str, float] = {}
        for (stage, _), seconds in self.seconds.items():
            out[stage] = out.get(stage, 0.0) + seconds / count * 1e3
        return out


class Maps:
    """The HRM and the part of the GLRM that it covers, as flat arrays; the HRM's tile is the one around the robot."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.hrm = np.zeros(SIDE * SIDE, terrain.CELL)
        self.glrm = np.zeros((GLRM_SIDE, GLRM_SIDE), terrain.CELL)

    def under(self) -> Array:
        """The GLRM's cells under the HRM, in the GLRM's middle."""
        first = (GLRM_SIDE - SIDE // FACTOR) // 2
        return self.glrm[first : first + SIDE // FACTOR, first : first + SIDE // FACTOR]

    def into_glrm(self, fuse: Callable[[Array, Array], Array], llrm: Array) -> None:
        """Fuse an LLRM in."""
        cells = np.ascontiguousarray(opaque(self.under())).view(terrain.CELL).reshape(-1)
        opaque(self.under())[...] = opaque(fuse(cells, llrm.reshape(-1))).reshape(llrm.shape)


class Compiled(Maps):
    """The model's kernels, in the order in which its observer, its tiles and a station call them."""

    def __init__(self) -> None:
        super().__init__()
        self.grid, self.first_slot = np.zeros(rasterise.NOWHERE + 1, np.int32), 1
        self.points, self.later = terrain_points.new_points(POINTS), np.empty(POINTS, np.int64)
        self.places, self.sums = np.empty(POINTS, np.int32), np.empty(POINTS, terrain_points.SUMS)
        self.cells, self.keys = np.zeros(POINTS, terrain.CELL), np.empty((10_000, 2), np.int64)
        self.tile_of, self.at = np.empty(POINTS, np.int32), np.empty(POINTS, np.int32)

    def take(self, scan: Scan, revision: int) -> None:
        timed, T, per_m = self.clock.time, scan.T_world_sensor.matrix, HRM.cells_per_m
        i0, j0 = (int(c) - rasterise.WINDOW // 2 for c in HRM.cell(T[:2, 3]))
        dropped = np.zeros(5, np.int64)
        lattice = (per_m, i0, j0, 0.0, RANGE_M**2, ACROSS)
        timed(POINT_LIST, terrain_points.locate, scan.points, T, *lattice, *self.points, dropped, self.later)
        count = timed(HEIGHTS, self._heights, len(scan.points), T[2, 3])
        grid = (self.grid, self.first_slot - count)
        timed(GRADIENTS, self._gradients, count, *grid)
        where = (self.places, count, i0, j0, T, per_m, RANGE_M, MODEL.subcells)
        timed(CONFIDENCE, terrain_planes.assess, self.sums, *where, self.cells)
        timed(OCCUPATION, terrain_planes.occupy_all, count, MODEL.max_slope, self.cells)
        timed(INTO_HRM, self._into_hrm, count, i0, j0, scan.stamp_ns, revision)
        llrm = timed(INTO_LLRM, self._coarsen)
        timed(INTO_GLRM, self.into_glrm, fuse, llrm)

    def _heights(self, count: int, sensor_z: float) -> int:
        cells = terrain_points.add_up(*self.points, count, self.grid, self.first_slot, self.places, self.sums)
        self.first_slot += cells
        terrain_planes.fit(self.sums, cells, sensor_z, HRM.cells_per_m, SHAPE, self.cells)
        return int(cells)

    def _gradients(self, count: int, grid: Array, first_slot: int) -> None:
        where, per_m = (self.sums, self.places, count, grid, first_slot), HRM.cells_per_m
        terrain_planes.difference_neighbours(*where, per_m, MODEL.point_sigma_m, self.cells)

    def _into_hrm(self, count: int, i0: int, j0: int, stamp_ns: int, revision: int) -> None:
        tiles, _ = rasterise.divide(self.places, self.cells, count, i0, j0, SIDE, self.keys, self.tile_of, self.at)
        assert tiles == 1
        addresses = np.array([self.hrm.ctypes.data])
        cells = self.cells[:count]
        terrain_merge.merge(addresses, self.tile_of[:count], self.at[:count], cells, stamp_ns, revision, FINE)

    def _coarsen(self) -> Array:
        out = np.zeros((SIDE // FACTOR, SIDE // FACTOR), terrain.CELL)
        terrain_coarsen.coarsen(self.hrm.reshape(SIDE, SIDE), FACTOR, FINE, out)
        return out


def fuse(own: Array, new: Array) -> Array:
    terrain_fuse.fuse(own, new, COARSE)
    return own


class Reference(Maps):
    """The same by NumPy."""

    def take(self, scan: Scan, revision: int) -> None:
        timed, T, per_m = self.clock.time, scan.T_world_sensor.matrix, HRM.cells_per_m
        i, j, *uvw = timed(POINT_LIST, terrain_points.locate_reference, scan.points, T, per_m, 0.0, RANGE_M)
        i, j, sums, cells = timed(HEIGHTS, self._heights, i, j, uvw, T[2, 3])
        differences = terrain_planes.difference_neighbours_reference
        timed(GRADIENTS, differences, i, j, sums, cells, per_m, MODEL.point_sigma_m)
        where = (i, j, sums, T, per_m, RANGE_M, MODEL.subcells)
        cells["confidence"] = timed(CONFIDENCE, terrain_planes.assess_reference, *where)
        timed(OCCUPATION, terrain_planes.occupy_reference, cells, MODEL.max_slope)
        timed(INTO_HRM, self._into_hrm, i, j, cells, scan.stamp_ns, revision)
        fine = self.hrm.reshape(SIDE, SIDE)
        llrm = timed(INTO_LLRM, terrain_coarsen.coarsen_reference, fine, FACTOR, FINE)
        timed(INTO_GLRM, self.into_glrm, fuse_reference, llrm)

    def _heights(self, i: Array, j: Array, uvw: list[Array], sensor_z: float) -> tuple[Array, Array, Array, Array]:
        i, j, sums = terrain_points.add_up_reference(i, j, *uvw, ACROSS)
        return i, j, sums, terrain_planes.fit_reference(sums, sensor_z, HRM.cells_per_m, SHAPE)

    def _into_hrm(self, i: Array, j: Array, cells: Array, stamp_ns: int, revision: int) -> None:
        at = j * SIDE + i
        self.hrm[at] = terrain_merge.merge_reference(self.hrm[at], cells, stamp_ns, revision, FINE)


def fuse_reference(own: Array, new: Array) -> Array:
    return terrain_fuse.fuse_reference(own, new, COARSE)


class Product(Maps):
    """What a robot and a station really do: `Mapper.integrate`, then `Terrain.coarsen` and `Terrain.fuse`."""

    def __init__(self) -> None:
        super().__init__()
        self.mapper = Mapper("r1", HRM, MODEL)

    def take(self, scan: Scan, revision: int) -> None:
        self.clock.time("Mapper.integrate", self.mapper.integrate, scan)
        (tile,) = self.mapper.delta(revision - 1).tiles
        self.hrm[tile.at] = tile.cells
        llrm = self.clock.time("Terrain.coarsen", MODEL.coarsen, self.hrm.reshape(SIDE, SIDE), FACTOR)
        self.clock.time("Terrain.fuse", self.into_glrm, partial(MODEL.fuse, lattice=HRM.coarser(FACTOR)), llrm)


def scans(count: int) -> list[Scan]:
    """Of a robot that drives 0.1 m a scan through the middle of its HRM: 64 beams, float32, in the sensor's frame."""
    world, rng = scene(), np.random.default_rng(0)
    lidar = Lidar(beams=64, columns=2200, lowest_deg=-24.8, highest_deg=2.0, max_range_m=RANGE_M)
    out = []
    for k in range(count):
        x, y = 80.0 + 0.1 * k, 80.0
        pose = Pose.identity().shifted(x, y, float(world.ground.height(x, y)) + 1.8)
        points = scan(world, lidar, pose, 0.0, rng)
        points = points[np.isfinite(points[:, 0])]
        points = points[np.hypot(points[:, 0], points[:, 1]) < RANGE_M][:POINTS]
        assert len(points) == POINTS, f"only {len(points)} returns"
        out.append(Scan(k * 100_000_000, points, pose))
    return out


def agree(one: Maps, other: Maps) -> dict[str, float]:
    """The largest difference between two maps, of each field of the cells."""
    return {
        name: float(np.abs(a[name].astype(np.float64) - b[name].astype(np.float64)).max())
        for a, b in ((one.hrm, other.hrm), (one.glrm, other.glrm))
        for name in ("height", "gradient_x", "gradient_y", "occupation", "confidence", "flags")
    }


def measure(count: int, rounds: int) -> dict[str, Any]:
    stream = scans(count)
    compiled, reference, product = Compiled(), Reference(), Product()
    for turn in range(rounds):
        numbered = [
            (1 + turn * count + k, replace(one, stamp_ns=(1 + turn * count + k) * 100_000_000))
            for k, one in enumerate(stream)
        ]
        for contender in (compiled, reference, product):
            for k, (revision, one) in enumerate(numbered):
                contender.clock.scan = k
                contender.take(one, revision)
    for one, other in ((product.hrm, compiled.hrm), (product.glrm, compiled.glrm)):
        assert one.tobytes() == other.tobytes(), "the stages do not do what the product does"
    ours, numpys, whole = (contender.clock.milliseconds() for contender in (compiled, reference, product))
    total, total_numpy, total_product = sum(ours.values()), sum(numpys.values()), sum(whole.values())
    return {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "scan": {"points": POINTS, "HRM cells known": int((compiled.hrm["flags"] > 0).sum())},
        "milliseconds": {
            stage: {
                "terrafuse": round(ours[stage], 3),
                "NumPy": round(numpys[stage], 2),
                "ratio": round(numpys[stage] / ours[stage], 1),
                "paper": list(STAGES_OF_PAPER[stage]),
            }
            for stage in STAGES_OF_PAPER
        },
        "whole scan": {
            "terrafuse": round(total, 2),
            "NumPy": round(total_numpy, 1),
            "paper": [sum(robot) for robot in zip(*STAGES_OF_PAPER.values(), strict=True)],
        },
        "as the product does it": {
            **{stage: round(ms, 3) for stage, ms in whole.items()},
            "sum": round(total_product, 2),
        },
        "ratios": {
            "NumPy / terrafuse": round(total_numpy / total, 1),
            "NumPy / as the product does it": round(total_numpy / total_product, 1),
        },
        "largest differences": agree(compiled, reference),
    }


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--scans", type=int, default=5)
    arguments_of.add_argument("--rounds", type=int, default=10)
    arguments = arguments_of.parse_args()
    tell(measure(arguments.scans, arguments.rounds), arguments.json)


if __name__ == "__main__":
    main()
