"""What the hallway shows: how fast wanderers map the floor, what windows waste, how long a robot pauses for its map.

The *database* paper: nine blocks of 100 × 100 cells around a robot, or what it can see before its next update; a pause
of some 5 s whenever a robot came into another block and wrote to the database.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from terrafuse.simulate import truth
from terrafuse.simulate.mission.engine import Mission, lattice_of, model_of
from terrafuse.simulate.mission.tables import Cell, Table, moments
from terrafuse.simulate.mission.vehicle import Vehicle
from terrafuse.simulate.scenario import Loaded, with_robots
from terrafuse.simulate.scenario.read import changed
from terrafuse.simulate.worlds.hallway import EAST_M, NORTH_M
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Array, Bounds
from terrafuse.window import Residency, make_window

FLOOR = Bounds(0.0, 0.0, EAST_M, NORTH_M)
BAND_M = (0.3, 1.8)
MAPPED = 0.9
FLEETS = (1, 2, 3)
LONGEST_S = 6000.0
SAMPLE_S = 5.0
PAPER_PAUSE_S = 5.0
NINE_BLOCK = "nine_block"


class Growth:
    """A watcher: how much of the free floor robots have on their own maps together, reported or not.

    It stops the mission once that is `until`.
    """

    def __init__(self, mission: Mission, until: float | None = None) -> None:
        lattice = mission.lattice
        self.rows: list[tuple[float, float]] = []
        """Simulated seconds, share of the free floor."""
        self._window = lattice.cell_window(FLOOR)
        self._free = ~truth.occupied(mission.world, lattice, self._window, BAND_M)
        self._corridor = self._free & truth.streets(mission.world, lattice, self._window)
        self._seen: Array = np.zeros(self._free.shape, bool)
        self._revisions = dict.fromkeys((vehicle.name for vehicle in mission.vehicles), 0)
        self._until, self._next_s = until, 0.0

    def __call__(self, mission: Mission) -> None:
        if mission.now_s + 1e-9 < self._next_s:
            return
        self._next_s += SAMPLE_S
        for vehicle in mission.vehicles:
            self._take(vehicle)
        self.rows.append((round(mission.now_s, 3), self._share(self._free)))
        if self._until is not None and self.rows[-1][1] >= self._until:
            mission.stop()

    def reached_s(self, share: float) -> float | None:
        """The first time at which so much of the floor was mapped."""
        return next((row[0] for row in self.rows if row[1] >= share), None)

    def table(self) -> Table:
        """A dozen moments."""
        ninety_s = self.reached_s(MAPPED)
        when = "was not reached" if ninety_s is None else f"was reached after {ninety_s:,.0f} s"
        return Table(
            "How much of the free floor is mapped",
            ("simulated s", "share of the floor"),
            tuple(moments(self.rows, 12)),
            f"By the robots together, corridor and rooms, {self._free.sum():,} cells. {MAPPED:.0%} {when}. Of the "
            f"corridor, {self._share(self._corridor):.1%} is mapped in the end.",
        )

    def _share(self, where: Array) -> float:
        return float((self._seen & where).sum() / where.sum())

    def _take(self, vehicle: Vehicle) -> None:
        i0, j0, _, _ = self._window
        side = vehicle.mapper.lattice.tile_cells
        for tile in vehicle.mapper.delta(self._revisions[vehicle.name]).tiles:
            j, i = np.divmod(tile.at, side)
            i, j = i + tile.key.x * side - i0, j + tile.key.y * side - j0
            inside = (i >= 0) & (j >= 0) & (i < self._seen.shape[1]) & (j < self._seen.shape[0])
            self._seen[j[inside], i[inside]] = True
        self._revisions[vehicle.name] = vehicle.mapper.revision


# --- windows ---------------------------------------------------------------------------------------------------------


def window_table(mission: Mission) -> Table:
    """What the paper's two windows would claim on the very ways that the robots took."""
    windows = list(dict.fromkeys((NINE_BLOCK, mission.scenario.map.window)))
    cells = mission.lattice.tile_cells
    return Table(
        f"Allocated against observed cells, blocks of {cells} × {cells}",
        (
            "robot",
            "window",
            "held at once",
            "allocated",
            "observed",
            "observed of allocated",
            "touched blocks",
            "of these",
        ),
        tuple(_claims(mission, vehicle, window) for vehicle in mission.vehicles for window in windows),
        "One and the same run and scans. Allocated: all blocks that were ever inside the window, as in the paper, on "
        "the robot and in its database. Touched blocks: what terrafuse allocates, one with the first reading in it.",
    )


def _claims(mission: Mission, vehicle: Vehicle, window: str) -> tuple[Cell, ...]:
    residency = Residency(make_window(window, mission.lattice))
    for point in mission.store.poses(vehicle.name):
        east_m, north_m, _ = point.T_world_sensor.position.tolist()
        residency.move(east_m, north_m)
    block, own = mission.lattice.tile_cells**2, vehicle.mapper.allocation()
    claimed = len(residency.visited.union(vehicle.mapper.keys)) * block
    return (
        vehicle.name, window.partition("?")[0], residency.most_tiles * block, claimed, own.observed_cells,
        own.observed_cells / claimed, own.allocated_cells, own.observed_of_allocated,
    )  # fmt: skip


# --- pauses ----------------------------------------------------------------------------------------------------------


def pause_table(missions: Sequence[Mission]) -> Table:
    """How long each robot's scans took to get into its map, and what is out of memory into the store and back."""
    return Table(
        "Pauses for the map",
        ("robots", "robot", "window", "longest pause, ms", "mean, ms", "a round of the sonars, ms", "rounds missed",
         "blocks written", "read back", "commits", "paper's pause, ms"),
        tuple(_pause_row(mission, vehicle) for mission in missions for vehicle in mission.vehicles),
        "A pause is the longest that a scan took: cones, cells, and where blocks left the window, their commit to the "
        "mission's store on the robot's own thread, and reading back; by the clock on the wall. The first scan of each "
        "robot, which loads compiled loops, is left out. Coarsening and telling others is no part of it, but "
        "of 'exchange', below.",
    )  # fmt: skip


def _pause_row(mission: Mission, vehicle: Vehicle) -> tuple[Cell, ...]:
    scans, paging = max(vehicle.mapper.revision, 1), vehicle.mapper.paging
    round_s = vehicle.senses[0].period_ns / 1e9 or mission.scenario.tick_s
    return (
        len(mission.vehicles), vehicle.name, mission.scenario.map.window.partition("?")[0],
        1e3 * vehicle.longest_pause_s, 1e3 * vehicle.seconds["map"] / scans, 1e3 * round_s,
        int(vehicle.longest_pause_s // round_s), paging.writes, paging.loads, paging.commits, 1e3 * PAPER_PAUSE_S,
    )  # fmt: skip


# --- several missions ------------------------------------------------------------------------------------------------


def sweep(
    loaded: Loaded,
    fleets: Sequence[int] = FLEETS,
    longest_s: float = LONGEST_S,
    tell: Callable[[str], None] = lambda _: None,
) -> list[Table]:
    """One to three robots until most of the floor is mapped; the largest fleet with nine blocks, too."""
    rows, missions = [], []
    for robots, window in [*((count, loaded.scenario.map.window) for count in fleets), (fleets[-1], NINE_BLOCK)]:
        tell(f"{robots} robots, {window.partition('?')[0]}")
        for mission, growth in _until_mapped(changed(loaded, duration_s=longest_s), robots, window):
            rows.append(_fleet_row(mission, growth))
            missions.append(mission)
    return [fleet_table(rows), pause_table(missions)]


def _until_mapped(loaded: Loaded, robots: int, window: str) -> Iterator[tuple[Mission, Growth]]:
    """The mission, with its store open."""
    part = loaded.scenario.map.model_copy(update={"window": window})
    several = with_robots(loaded, robots)
    several = replace(several, scenario=several.scenario.model_copy(update={"map": part}))
    with TemporaryDirectory() as folder:
        store = SqliteStore.create(Path(folder) / "map.db", lattice_of(several), model_of(several))
        mission = Mission(several, store)
        growth = Growth(mission, until=MAPPED)
        mission.run([growth])
        yield mission, growth
        store.close()


def fleet_table(rows: Sequence[tuple[Cell, ...]]) -> Table:
    return Table(
        f"Simulated seconds until {MAPPED:.0%} of the free floor is mapped",
        ("robots", "window", "seconds", "mapped in the end", "allocated cells", "observed cells",
         "observed of allocated", "digest of the map"),
        tuple(rows),
        "Robots only wander: a robot more is a draw more, no plan. A window decides about memory, never about the map.",
    )  # fmt: skip


def _fleet_row(mission: Mission, growth: Growth) -> tuple[Cell, ...]:
    held = [vehicle.mapper.allocation() for vehicle in mission.vehicles]
    claimed, observed = (sum(getattr(one, what) for one in held) for what in ("window_cells", "observed_cells"))
    return (
        len(held), mission.scenario.map.window.partition("?")[0], growth.reached_s(MAPPED), growth.rows[-1][1], claimed,
        observed, observed / claimed, mission.station.replica.digest()[:12],
    )  # fmt: skip
