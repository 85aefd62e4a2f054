"""What a station refuses: of robots that lie, of robots that are far from what they report, and by whose leave."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from terrafuse.exchange.channel import Channel
from terrafuse.exchange.courier import Courier
from terrafuse.exchange.framing import HEADER_BYTES, frames_of
from terrafuse.exchange.links import Link, MemoryHub
from terrafuse.keys.fleet import Fleet, Member, Roster, write_roster
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.services import places
from terrafuse.services.gate import Gate, Roll
from terrafuse.services.node import Node, make_node
from terrafuse.services.places import Place, Told, Track, encode
from terrafuse.services.run import run
from terrafuse.services.settings import FleetSettings, QuotasPart
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.types import Bounds, Pose, Scan, TileKey
from tests.services.test_one_process import digest, finished, mapped_at_once, nodes_of, settings_of

LATTICE, MODEL = Lattice(0.2, 40.0), make_model("elevation")


def scan_at(east: float, north: float, stamp_ns: int = 0) -> Scan:
    return Scan(stamp_ns, np.zeros((1, 3), np.float32), Pose.identity().shifted(east, north, 1.0))


def test_a_track_is_short_however_long_the_way() -> None:
    """10 km in steps of a metre: 500 places of 20 m are too many for 256, so they are 40 m apart."""
    track = Track()
    for metre in range(10_000):
        track.add(scan_at(float(metre), 0.0, metre))
    told = places.decode_track(encode(track.told()))
    east = told.places_m[::2]
    assert told.spacing_m == 40.0
    assert east[0] == 0
    assert len(east) <= places.MOST_PLACES
    assert max(later - earlier for earlier, later in pairwise(east)) <= 40
    assert 10_000 - east[-1] <= 40
    assert len(encode(track.told())) < 2000
    assert track.latest == Place(9999, 9999.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "payload", [b"", b"\xc1", encode([1, 2.0]), encode([1, float("nan"), 0.0, 0.0]), encode([1, 1e300, 0.0, 0.0])]
)
def test_what_is_no_place_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError):
        places.decode_place(payload)


@pytest.mark.parametrize(
    "payload",
    [b"", encode(Told(20.0, [1])), encode(Told(0.0, [])), encode(Told(20.0, [1] * 2000)), encode([20.0, [1.5, 2.5]])],
)
def test_what_is_no_track_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError):
        places.decode_track(payload)


def test_tiles_may_be_as_far_as_the_quota_from_where_a_robot_says_it_was() -> None:
    store = MemoryStore(LATTICE, MODEL)
    gate = Gate([store], QuotasPart(distance_m=100.0), None)
    guard = gate.channel("fine", 0, store).guard
    assert guard is not None
    (good,) = deltas_of("r1", random_scans(1, 1), LATTICE, MODEL)
    far = replace(good, tiles=tuple(replace(t, key=TileKey(t.key.x + 25, t.key.y)) for t in good.tiles))
    now = good.stamp_ns + 1
    assert guard("r1", good, now, 1000) == "place"
    assert gate.hear("r1", places.PLACE, encode(Place(0, 0.0, 0.0, 0.0)), now)
    assert guard("r1", good, now, 1000) is None
    assert guard("r1", far, now, 1000) == "distance"
    assert gate.hear("r1", places.TRACK, encode(Told(20.0, [0, 0, 980, 0])), now)
    assert guard("r1", far, now, 1000) is None
    assert not gate.hear("r1", "else", b"", now)


def test_areas_of_interest_have_quotas() -> None:
    """Tiles of 40 m: 80 m by 40 m are two."""
    gate = Gate([MemoryStore(LATTICE, MODEL)], QuotasPart(area_tiles=2, all_area_tiles=3), None)
    small, two = Bounds(1.0, 1.0, 2.0, 2.0), Bounds(0.0, 0.0, 80.0, 40.0)
    assert gate.grant("r1", two)
    assert not gate.grant("r1", Bounds(0.0, 0.0, 81.0, 40.0))
    assert gate.within([two, small, small]) == [two, small]


def test_a_message_may_have_a_whole_tile() -> None:
    """Of 1000 cells a side: a million."""
    store = MemoryStore(Lattice(0.04, 40.0), MODEL)
    (good,) = deltas_of("r1", random_scans(1, 1), store.map.lattice, MODEL)
    tile = good.tiles[0]
    whole = replace(tile, at=np.arange(10**6, dtype=np.int32), cells=np.resize(tile.cells, 10**6))
    guard = Gate([store], QuotasPart(), None).channel("fine", 0, store).guard
    assert guard is not None
    assert guard("r1", replace(good, tiles=(whole,)), good.stamp_ns, 1000) is None


def test_keys_say_who_may_report_whom_even_when_they_change(tmp_path: Path) -> None:
    fleet = Fleet.new(tmp_path / "fleet")
    fleet.add("station", station=True, hosts=["127.0.0.1"])
    fleet.add("r5")
    roll = Roll(fleet.node_folder("station"))
    assert roll.allows("station", "r5")
    assert roll.allows("r5", "r5")
    assert not roll.allows("r5", "r4")
    assert not roll.allows("r6", "r6")
    fleet.add("r6", relay_for=["r5"])
    assert roll.allows("r6", "r5")
    assert not roll.allows("r6", "r4")
    fleet.revoke("r5")
    assert not roll.allows("r5", "r5")
    (fleet.node_folder("station") / "fleet.json").write_text("{")
    assert roll.allows("r6", "r6")
    write_roster(fleet.node_folder("station") / "fleet.json", Roster("f", (member_of(fleet, "station"),)))
    assert not roll.allows("r6", "r6")


def member_of(fleet: Fleet, name: str) -> Member:
    return fleet.member(name)


def counted(station: Node) -> dict[str, int]:
    counts = station.statuses["map-manager"].counts
    return {key: n for key, n in counts.items() if key.startswith("refused.")}


def until(done: Callable[[], bool], act: Callable[[], object] = lambda: None) -> None:
    deadline = time.monotonic() + 30
    while not done():
        assert time.monotonic() < deadline
        act()
        time.sleep(0.02)


class Elsewhere:
    """A link that sends on another's topics."""

    def __init__(self, link: Link, told: str, instead: str) -> None:
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.listen, self.receive, self.close = link.listen, link.receive, link.close
        self._link, self._told, self._instead = link, told, instead

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        whole = topic.replace(f"/{self._told}/", f"/{self._instead}/")
        for frame in frames_of(whole, payload[HEADER_BYTES:], self.max_frame_bytes):
            self._link.send(*frame, now_ns)


def test_a_topic_says_whose_report_is_in_it(logs: dict[str, Path], tmp_path: Path) -> None:
    """A node says on its own topic, as carriers' rules allow it, what is r9's."""
    settings = settings_of({"r1": logs["r1"]}, tmp_path)
    hub = MemoryHub()
    station = make_node(settings, "station", lambda node: lambda: hub.link(node))
    forged = MemoryStore(LATTICE, MODEL)
    for delta in deltas_of("r9", random_scans(1, 3), LATTICE, MODEL):
        forged.accept(delta)
    link = Elsewhere(hub.link("evil"), "r9", "evil")
    evil = Courier(link, [Channel("fine", forged, relay=True)], peers=["station"])
    station.supervisor.start()
    try:
        until(
            lambda: bool(counted(station).keys() & {"refused.topic", "refused.sender"}),
            lambda: evil.tick(time.time_ns()),
        )
    finally:
        station.supervisor.stop(5)
        station.close()
    with SqliteStore.open(tmp_path / "station.db") as store:
        assert store.robots() == []


def with_quotas(settings: FleetSettings, **quotas: float) -> FleetSettings:
    assert settings.station is not None
    part = settings.station.model_copy(update={"quotas": QuotasPart(**quotas)})  # type: ignore[arg-type]
    return settings.model_copy(update={"station": part})


def test_a_fleet_with_a_distance_quota_maps_as_without(logs: dict[str, Path], tmp_path: Path) -> None:
    """Robots say where they are; one that went on by itself before does so, too."""
    settings = with_quotas(settings_of(logs, tmp_path), distance_m=60.0)
    stop = threading.Event()
    threading.Timer(0.7, stop.set).start()
    run(nodes_of(settings), stop)
    nodes = nodes_of(settings)
    finished(nodes)
    assert digest(tmp_path / "station.db") == mapped_at_once(settings, tmp_path)
    assert "refused.distance" not in counted(nodes[0])


def test_what_is_too_much_at_once_comes_later(logs: dict[str, Path], tmp_path: Path) -> None:
    """Of some 660 kB in 3 s, at most 540 kB at once, and 18 kB a second."""
    settings = with_quotas(settings_of({"r1": logs["r1"]}, tmp_path), bytes_per_s=18_000.0)
    robot = settings.robots["r1"].model_copy(update={"bytes_per_s": 200_000.0})
    settings = settings.model_copy(update={"robots": {"r1": robot}})
    hub = MemoryHub()
    nodes = [make_node(settings, name, lambda node: lambda: hub.link(node)) for name in settings.nodes]
    finished(nodes)
    assert counted(nodes[0])["refused.rate"] > 0
    assert digest(tmp_path / "station.db") == mapped_at_once(settings, tmp_path)
