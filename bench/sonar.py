"""python -m bench.sonar [--json FILE] [--scans N]

The *database* paper's case: a ring of 16 sonars of 50 inch range on cells of 1 inch, in a hallway; and the most that a
ring can say, 16 readings at maximum range. Everybody goes through all scans before the next round, so that a slow spell
of the machine hits all alike; a scan's time is the least of the rounds.
"""

from __future__ import annotations

import math
import platform
from typing import Any

import numpy as np

from bench.__main__ import Work, seconds_of_all
from bench.report import parser, tell
from terrafuse.kernels import grey
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import MODELS
from terrafuse.models.grey import Grey, aimed
from terrafuse.sense import load_sensor, scan_of
from terrafuse.types import Array, Floats, Pose, Scan

INCH_M = 0.0254
LATTICE = Lattice(INCH_M, 1000 * INCH_M)
SENSOR = load_sensor("nomad_200_sonar")
HALF_WIDTH_M = 0.9
SCAN_NS = 320_000_000
MODELS_TIMED = ("grey", "occupancy")


def nearest_wall_m(y: float, heading: float) -> float:
    """What a sonar hears that looks along `heading` from `y` off the middle of the hallway: the wall's nearest part."""
    rays = np.sin(heading + np.linspace(-SENSOR.beam.half_angle_rad, SENSOR.beam.half_angle_rad, 31))
    with np.errstate(divide="ignore"):
        return float(((np.copysign(HALF_WIDTH_M, rays) - y) / rays).min())


def hallway(count: int) -> list[Scan]:
    """A robot that weaves along a hallway, 5 cm a scan."""
    rng, scans = np.random.default_rng(0), []
    for k in range(count):
        y, yaw = 0.25 * math.sin(0.05 * k), 0.3 * math.cos(0.05 * k)
        headings = yaw + np.arange(16) * math.radians(22.5)
        apices = y + SENSOR.radius_m * np.sin(headings)
        heard = [nearest_wall_m(at, heading) for at, heading in zip(apices, headings, strict=True)]
        readings = np.minimum(np.array(heard) + rng.normal(0, SENSOR.noise_sigma_m, 16), SENSOR.max_range_m)
        pose = Pose.from_quaternion((0.05 * k, y, 0.0), (0, 0, math.sin(yaw / 2), math.cos(yaw / 2)))
        scans.append(scan_of(SENSOR, readings, k * SCAN_NS, pose))
    return scans


def open_space(count: int) -> list[Scan]:
    """The same way without walls: every sonar reads its maximum."""
    readings = np.full(16, SENSOR.max_range_m)
    return [scan_of(SENSOR, readings, scan.stamp_ns, scan.T_world_sensor) for scan in hallway(count)]


class NumPyGrey:
    """Whole arrays instead of loops: each cone's square of cells, by the paper's formulas, into one fixed map.

    It has no tiles, no stamps and no list of what changed.
    """

    def __init__(self, sonar: grey.Sonar) -> None:
        self.sonar = sonar
        self.a, self.c = (np.zeros((1000, 4000), np.uint16) for _ in range(2))

    def take(self, scan: Scan) -> None:
        beams, _ = aimed(scan, LATTICE.cells_per_m)
        for beam in beams:
            i0, j0, a, c = self.says(beam)
            where = np.s_[j0 + 500 : j0 + 500 + len(a), i0 + 500 : i0 + 500 + len(a)]
            self.a[where], self.c[where] = self.fused(self.a[where], self.c[where], a, c)

    def says(self, beam: Floats) -> tuple[int, int, Array, Array]:
        x, y, axis_x, axis_y, reading, echo = beam.tolist()
        cells = math.ceil((reading + self.sonar.delta_r_m) / INCH_M) + 1
        i0, j0 = math.floor(x / INCH_M) - cells, math.floor(y / INCH_M) - cells
        steps = (np.arange(2 * cells + 1) + 0.5) * INCH_M
        dx, dy = np.meshgrid(i0 * INCH_M + steps - x, j0 * INCH_M + steps - y)
        theta = np.arctan2(axis_x * dy - axis_y * dx, axis_x * dx + axis_y * dy)
        theta[cells, cells] = 0.0
        a, b = grey.interval(np.hypot(dx, dy), theta, reading, bool(echo), self.sonar)
        return i0, j0, *(np.floor(side * grey.FULL).astype(np.uint16) for side in (a, 1.0 - b))

    @staticmethod
    def fused(a1: Array, c1: Array, a2: Array, c2: Array) -> tuple[Array, Array]:
        low_a, low_c, high_a, high_c = (f(*two) for f in (np.minimum, np.maximum) for two in ((a1, a2), (c1, c2)))
        void = (a1 == c1) | (a2 == c2)
        fits = high_a.astype(np.int32) + high_c <= grey.FULL
        over, under = (a1 > c1) & (a2 > c2), (a1 < c1) & (a2 < c2)
        return (
            np.where(void & fits | ~void & over, high_a, low_a),
            np.where(void & fits | ~void & under, high_c, low_c),
        )


def mapper_of(name: str, scans: list[Scan]) -> Mapper:
    """A mapper that has seen the place once, so that no tile is new when it is timed."""
    mapper = Mapper("r1", LATTICE, MODELS[name]())
    for scan in scans:
        mapper.integrate(scan)
    return mapper


def measure(scans: list[Scan]) -> dict[str, Any]:
    mappers = {name: mapper_of(name, scans) for name in MODELS_TIMED if name in MODELS}
    numpys = NumPyGrey(Grey().sonar(SENSOR.beam, LATTICE))
    works: dict[str, Work] = {
        **{name: (lambda _, scan, mapper=mapper: mapper.integrate(scan)) for name, mapper in mappers.items()},
        "grey, NumPy": lambda _, scan: numpys.take(scan),
    }
    cells = {name: mapper.integrate(scans[0]).cells for name, mapper in mappers.items()}
    seconds = seconds_of_all(works, scans)
    rates = {name: len(scans) / taken for name, taken in seconds.items()}
    return {
        "scans_per_second": {name: round(rate) for name, rate in rates.items()},
        "cells_of_the_first_scan": cells,
        "grey / grey, NumPy": round(rates["grey"] / rates["grey, NumPy"], 1),
    }


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--scans", type=int, default=300)
    arguments = arguments_of.parse_args()
    figures = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "ring": {"sonars": 16, "range_m": SENSOR.max_range_m, "cell_m": INCH_M, "scans": arguments.scans},
        "hallway": measure(hallway(arguments.scans)),
        "all at maximum range": measure(open_space(arguments.scans)),
    }
    tell(figures, arguments.json)


if __name__ == "__main__":
    main()
