"""How much of what each window claims is ever seen, in one and the same run: python -m tests.accuracy_windows

The case of the *database* paper (Barnes, Garcia, Quasny, Pyeatt): a robot with a ring of 16 sonars that reach 50 inches
goes down a hallway at an inch a second, here round a corner, and comes back. Cells of an inch, blocks of 100×100 cells.
Prints the table of docs/architecture.md as Markdown. The hallway is invented here, so it needs no recordings.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper, Paging
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.sense import Ring, Sensor, load_sensor, scan_of
from terrafuse.store.behind import WriteBehind
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Floats, Scan, pose_of
from terrafuse.window import Allocation, make_window

INCH_M = 0.0254
RANGE_M = 50 * INCH_M
SPEED_MPS = INCH_M
CYCLE_S = 1
"""Of the sonars: a scan of all 16."""
SECOND_NS = 1_000_000_000
MODEL = make_model("occupancy")


# --- the hallway, in inches ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Hallway:
    """An L, 72 inches wide: east along the first leg, then north. The robot starts in the middle of block (0, 0)."""

    first_leg: int = 480
    second_leg: int = 360

    @property
    def corners(self) -> Floats:
        """(6, 2), anticlockwise. The ends are 60 inches beyond the places where the robot turns round."""
        west, east, north = -10, 50 + self.first_leg + 36, 50 + self.second_leg + 60
        return np.array([(west, 14), (east, 14), (east, north), (east - 72, north), (east - 72, 86), (west, 86)], float)

    @property
    def way(self) -> list[tuple[float, float, float]]:
        """(x, y, heading) an inch apart: there, and back."""
        turn, end = 50 + self.first_leg, 50 + self.second_leg
        there = [(x, 50) for x in range(50, turn)] + [(turn, y) for y in range(50, end)]
        places = [*there, (turn, end), *there[::-1]]
        steps = np.diff(np.array([*places, places[-1]]), axis=0)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        return [(x, y, float(heading)) for (x, y), heading in zip(places, headings, strict=True)]


def distances(origin: tuple[float, float], angles: Floats, corners: Floats) -> Floats:
    """How far rays from a place inside go to the walls, (N,)."""
    start = corners - origin
    along = np.roll(corners, -1, axis=0) - corners
    way = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        slant = _cross(way, along)
        far, share = _cross(start, along) / slant, _cross(start, way) / slant
    hit = (slant != 0) & (far > 0) & (share >= 0) & (share <= 1)
    return np.where(hit, far, np.inf).min(axis=1)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


# --- its sonars ------------------------------------------------------------------------------------------------------


def ring() -> Sensor:
    """The Nomad 200's, measured from the robot's middle as the paper does."""
    sensor = load_sensor("nomad_200_sonar")
    assert isinstance(sensor.beams, Ring)
    return replace(sensor, beams=replace(sensor.beams, radius_m=0.0), max_range_m=RANGE_M)


def scans_of(hallway: Hallway) -> list[Scan]:
    """A scan an inch: each sonar reads the nearest wall within its cone."""
    sensor = ring()
    assert sensor.beams is not None
    azimuths, _ = sensor.beams.angles()
    cone = np.linspace(-sensor.cone_half_angle_rad, sensor.cone_half_angle_rad, 9)
    scans = []
    for k, (x, y, heading) in enumerate(hallway.way):
        angles = (heading + azimuths[:, None] + cone).ravel()
        nearest = distances((x, y), angles, hallway.corners).reshape(-1, len(cone)).min(axis=1)
        readings_m = np.minimum(nearest * INCH_M, RANGE_M)
        turn = np.array(
            [[math.cos(heading), -math.sin(heading), 0], [math.sin(heading), math.cos(heading), 0], [0, 0, 1]]
        )
        pose = pose_of(turn, np.array([x, y, 0.0]) * INCH_M)
        scans.append(scan_of(sensor, readings_m, k * CYCLE_S * SECOND_NS, pose))
    return scans


# --- the run ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    digest: str
    paging: Paging
    allocation: Allocation


def radius(cycles: int) -> str:
    """The window of equation 3 for an update every so many cycles of the sonars.

    The band of an echo at the full range reaches its error further, and the cell at its end a diagonal more.
    """
    range_m = RANGE_M + ring().range_error_m + math.sqrt(2) * INCH_M
    return f"radius?range_m={range_m}&period_s={cycles * CYCLE_S}&speed_mps={SPEED_MPS}"


def run(scans: Sequence[Scan], window: str, block_cells: int, folder: Path) -> Run:
    """Map the scans through a store on disk."""
    lattice = Lattice(INCH_M, block_cells * INCH_M)
    with SqliteStore.create(folder / "map.db", lattice, MODEL) as store:
        archive = WriteBehind(store)
        mapper = Mapper("nomad", lattice, MODEL, make_window(window, lattice), archive)
        for scan in scans:
            mapper.integrate(scan)
        mapper.commit()
        archive.close()
        return Run(Replica(store=store).digest(), mapper.paging, mapper.allocation())


CASES = {
    "nine_block, 100": ("nine_block", 100),
    "tiles3x3, 100": ("tiles3x3", 100),
    "centred, 120 cells, 100": ("centred?cells=120", 100),
    "radius, 10 cycles, 100": (radius(10), 100),
    "radius, 1 cycle, 100": (radius(1), 100),
    "radius, 1 cycle, 25": (radius(1), 25),
    "radius, 1 cycle, 10": (radius(1), 10),
}
"""By what the row is called: the window, and cells along a block. A cycle is one round of the sonars."""


def main() -> None:
    scans = scans_of(Hallway())
    print(f"{len(scans)} scans. Cells unless said otherwise; in brackets the share that was ever seen.\n")
    print("| window, block | held at once | ever inside | allocated | most in memory | loads | written | commits |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (window, block_cells) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            done = run(scans, window, block_cells, Path(folder))
        print(_line(name, done.allocation, done.paging))


def _line(name: str, held: Allocation, paging: Paging) -> str:
    columns = [
        name,
        f"{held.most_window_cells:,}",
        f"{held.window_cells:,} ({held.observed_of_window:.1%})",
        f"{held.allocated_cells:,} ({held.observed_of_allocated:.1%})",
        f"{held.most_allocated_cells:,}",
        *map(str, (paging.loads, paging.writes, paging.commits)),
    ]
    return f"| {' | '.join(columns)} |"


if __name__ == "__main__":
    main()
