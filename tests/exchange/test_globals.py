"""What the station tells robots of the whole map."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pytest

from terrafuse.exchange import globals as globals_
from terrafuse.exchange.area import tiles_in
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.globals import GlobalMap
from terrafuse.exchange.links import Faults, MemoryHub, MisbehavingLink
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import random_scans, scan_of
from terrafuse.types import Bounds, Scan, TileKey

STEP_NS, SECOND_NS = 100_000_000, 1_000_000_000
LATTICE, MODEL = Lattice(0.5, 4.0), make_model("elevation")
GLOBAL = "global"
QUICK = CourierSettings(period_s=0.5, answer_s=0.1, retry_s=0.5, longest_retry_s=2.0, message_cells=60)
HERE = Bounds(-4.0, -4.0, 4.0, 4.0)


@dataclass
class Fleet:
    """A station that folds, and robots that report to it and are told of the whole."""

    hub: MemoryHub = field(default_factory=lambda: MemoryHub(600))
    faults: Faults = field(default_factory=Faults)
    settings: CourierSettings = QUICK
    now_ns: int = 0

    def __post_init__(self) -> None:
        self.robots: dict[str, Courier] = {}
        self.mappers: dict[str, Mapper] = {}
        self.told: dict[str, Replica] = {}
        self.whole = Replica(LATTICE, MODEL)
        self.start_station()

    def start_station(self) -> None:
        self.folded = GlobalMap("station", Replica(store=self.whole.store))
        fine = Channel("fine", self.whole.store, relay=False, on_change=self.folded.changed)
        self.station = Courier(
            MisbehavingLink(self.hub.link("station"), self.faults, 9),
            [fine, Channel(GLOBAL, own=self.folded, near=True)],
            settings=self.settings,
        )

    def join(self, name: str, area: Bounds | None) -> None:
        self.mappers[name] = Mapper(name, LATTICE, MODEL)
        self.told[name] = Replica(LATTICE, MODEL)
        link = MisbehavingLink(self.hub.link(name), self.faults, len(self.robots))
        channels = [Channel("fine", own=self.mappers[name]), Channel(GLOBAL, self.told[name].store, near=True)]
        self.robots[name] = Courier(link, channels, peers=["station"], settings=self.settings)
        self.robots[name].area = area

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * SECOND_NS / STEP_NS)):
            self.folded.update(self.station.areas)
            self.station.tick(self.now_ns)
            for courier in self.robots.values():
                courier.tick(self.now_ns)
            self.now_ns += STEP_NS

    def level(self, name: str) -> bool:
        """Whether a robot has the station's map, byte for byte, in its area and nothing beyond."""
        area = self.robots[name].area
        assert area is not None
        inside = [key for key in self.whole.keys if _meets(key, area)]
        same = all(self.whole.cells(key).tobytes() == self.told[name].cells(key).tobytes() for key in inside)
        return same and self.told[name].keys == inside


def _meets(key: TileKey, area: Bounds) -> bool:
    tile = LATTICE.tile_bounds(key)
    return tile.west < area.east and area.west < tile.east and tile.south < area.north and area.south < tile.north


def explore(fleet: Fleet, name: str, scans: list[Scan]) -> None:
    for scan in scans:
        fleet.mappers[name].integrate(scan)
        fleet.run(0.5)


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_robots_have_the_fold_of_their_area_byte_for_byte(loss: float) -> None:
    fleet = Fleet(faults=Faults(loss=loss, duplication=loss))
    for k, name in enumerate(("r1", "r2")):
        fleet.join(name, HERE)
        explore(fleet, name, random_scans(k, 6, 20.0, 60))
    fleet.run(60 if loss else 5)
    assert fleet.whole.robots == ["r1", "r2"]
    assert len(fleet.whole.keys) > 4
    for name in ("r1", "r2"):
        assert fleet.level(name)
        assert fleet.told[name].robots == ["station"]
        assert fleet.mappers[name].robot == name
    assert fleet.station.behind("r1") == {}


def test_who_joins_late_gets_its_area_within_the_budget() -> None:
    fleet = Fleet(settings=CourierSettings(bytes_per_s=5000.0))
    fleet.join("r1", None)
    explore(fleet, "r1", random_scans(1, 20, 40.0, 300))
    fleet.run(60)
    fleet.join("r2", HERE)
    before = _bytes(fleet.station.counts)
    fleet.run(20)
    assert fleet.level("r2")
    assert _bytes(fleet.station.counts) - before <= 20 * 5000 * 1.05


def _bytes(counts: Counter[str]) -> int:
    return sum(number for name, number in counts.items() if name.startswith("bytes_sent"))


def test_who_drives_on_gets_what_is_there() -> None:
    fleet = Fleet()
    fleet.join("r1", None)
    explore(fleet, "r1", random_scans(1, 4, 40.0, 200))
    fleet.join("r2", HERE)
    fleet.run(5)
    sent = fleet.station.counts["bytes_sent.delta"]
    there = Bounds(8.0, 8.0, 16.0, 16.0)
    fleet.robots["r2"].area = there
    fleet.run(5)
    inside = {key for key in fleet.whole.keys if _meets(key, HERE) or _meets(key, there)}
    assert set(fleet.told["r2"].keys) == inside
    # What it had is not sent again: about as much as before for an area as large.
    assert fleet.station.counts["bytes_sent.delta"] - sent < 1.6 * sent


def test_what_is_folded_alike_is_not_told_again() -> None:
    """A robot looks again where it did, and only there the map changes."""
    fleet = Fleet()
    fleet.join("r1", HERE)
    explore(fleet, "r1", random_scans(1, 3, 7.0, 60))
    fleet.run(5)
    before = fleet.folded.revision
    assert fleet.folded.update() == 0
    fleet.mappers["r1"].integrate(scan_of([[0.2, 0.2, 1.0]], 10 * SECOND_NS))
    fleet.run(3)
    (tile,) = fleet.folded.delta(before).tiles
    assert tile.at.tolist() == [0]
    assert fleet.level("r1")


def test_a_station_that_was_started_afresh_tells_it_anew() -> None:
    """It counts from 1 again, and robots hold more."""
    fleet = Fleet()
    fleet.join("r1", HERE)
    explore(fleet, "r1", random_scans(1, 6, 7.0, 60))
    fleet.run(2)
    fleet.station._link.close()
    fleet.start_station()
    explore(fleet, "r1", random_scans(2, 2, 7.0, 60))
    fleet.run(8)
    assert fleet.level("r1")


def test_the_fold_says_which_cells_changed() -> None:
    whole = Replica(LATTICE, MODEL)
    folded = GlobalMap("station", whole)
    for robot, x_m in (("r1", 0.2), ("r2", 0.7), ("r1", 0.2)):
        mapper = Mapper(robot, LATTICE, MODEL)
        mapper.integrate(scan_of([[x_m, 0.2, 1.0]]))
        if whole.apply(mapper.delta()):
            folded.changed(robot, [tile.key for tile in mapper.delta().tiles])
        folded.update()
    (tile,) = folded.delta(0).tiles
    assert (tile.at.tolist(), tile.cells["revision"].tolist()) == ([0, 1], [1, 2])
    other = Replica(LATTICE, MODEL)
    other.apply(folded.delta(0))
    np.testing.assert_array_equal(other.cells(tile.key), whole.cells(tile.key))


def test_an_area_that_is_refused_is_of_no_interest() -> None:
    hub, asked = MemoryHub(), []

    def grant(peer: str, area: Bounds) -> bool:
        asked.append((peer, area))
        return tiles_in(area, LATTICE.tile_m) <= 4

    store = MemoryStore(LATTICE, MODEL)
    station = Courier(hub.link("station"), [Channel("fine", store)], grant=grant, settings=QUICK)
    robot = Courier(hub.link("r1"), peers=["station"], settings=QUICK)
    small = Bounds(-1.0, -1.0, 1.0, 1.0)
    for k, area in enumerate((small, Bounds(-5.0, -1.0, 5.0, 1.0), None, Bounds(0.0, 0.0, np.inf, 1.0))):
        robot.area = area
        for step in range(20):
            robot.tick((20 * k + step) * STEP_NS)
            station.tick((20 * k + step) * STEP_NS)
        assert station.areas == ([small] if k == 0 else [])
    assert len(asked) == 3
    assert station.counts["refused.area"] == 2


def test_tiles_that_meet_an_area() -> None:
    """Of 4 m: from -1 to 1 two, to 4 still two, and three to 4.1."""
    assert tiles_in(Bounds(-1.0, 0.0, 4.0, 4.0), 4.0) == 2
    assert tiles_in(Bounds(-1.0, 0.0, 4.1, 4.1), 4.0) == 6


def test_what_nobody_is_interested_in_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """And told again to who is."""
    monkeypatch.setattr(globals_, "MOST_TILES", 2)
    fleet = Fleet()
    fleet.join("r1", HERE)
    for scan in random_scans(3, 2, 20.0, 300):
        fleet.mappers["r1"].integrate(scan)
    fleet.run(20)
    assert len(fleet.folded._tiles) == 4
    there = Bounds(4.0, -4.0, 8.0, 4.0)
    fleet.robots["r1"].area = there
    fleet.run(20)
    assert sorted(fleet.folded._tiles) == [TileKey(1, -1), TileKey(1, 0)]
    fleet.join("r2", HERE)
    fleet.run(30)
    assert fleet.level("r2")
