"""A whole fleet in one process, over memory: its map is that of `terrafuse map`, whatever fails on the way."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import pytest

from terrafuse import mapping
from terrafuse.errors import InputError, StoreMismatch
from terrafuse.exchange.courier import Channel, Courier
from terrafuse.exchange.links import MemoryHub
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.services.carriers import carrier
from terrafuse.services.node import Node, make_node
from terrafuse.services.run import run
from terrafuse.services.service import Message
from terrafuse.services.settings import FleetSettings
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, random_scans


def settings_of(logs: dict[str, Path], folder: Path, **about: object) -> FleetSettings:
    return FleetSettings.model_validate({
        "map": {"resolution_m": 0.2, **about},
        "link": {"kind": "memory"},
        "station": {"store": str(folder / "station.db")},
        "robots": {name: {"source": str(log), "store": str(folder / f"{name}.db")} for name, log in logs.items()},
    })  # fmt: skip


def nodes_of(settings: FleetSettings) -> list[Node]:
    carry = carrier(settings, lambda text: None)
    return [make_node(settings, name, carry) for name in settings.nodes]


def finished(nodes: list[Node], seconds: float = 60.0) -> None:
    """Run to the end, but not without end."""
    stop = threading.Event()
    timer = threading.Timer(seconds, stop.set)
    timer.start()
    try:
        assert run(nodes, stop), [node.statuses for node in nodes]
    finally:
        timer.cancel()


def hold_something(store: Path) -> None:
    """Into a store that is there, a report."""
    with SqliteStore.open(store) as opened:
        (delta,) = deltas_of("r1", random_scans(1, 1), opened.map.lattice, opened.model)
        assert opened.accept(delta)


def digest(store: Path, factor: int = 1) -> str:
    with SqliteStore.open(store) as opened:
        return Replica(store=opened, factor=factor).digest()


def mapped_at_once(settings: FleetSettings, folder: Path, factor: int = 1) -> str:
    """What `terrafuse map` makes of the same logs."""
    plan = mapping.plan({name: part.source for name, part in settings.robots.items()}, settings.map)
    with mapping.open_partial(folder / "map.partial.db", plan) as store:
        mapping.map_logs(plan, store)
        return Replica(store=store, factor=factor).digest()


@pytest.mark.parametrize("factor", [1, 10])
def test_the_fleets_map_is_that_of_map(logs: dict[str, Path], tmp_path: Path, factor: int) -> None:
    settings = settings_of(logs, tmp_path, global_factor=factor)
    finished(nodes_of(settings))
    expected = mapped_at_once(settings, tmp_path)
    assert digest(tmp_path / "station.db") == expected
    if factor > 1:
        coarse = mapped_at_once(settings, tmp_path, factor)
        assert digest(tmp_path / "station.coarse.db") == coarse


def test_a_finished_fleet_has_nothing_to_do(logs: dict[str, Path], tmp_path: Path) -> None:
    settings = settings_of(logs, tmp_path)
    finished(nodes_of(settings))
    before = digest(tmp_path / "station.db")
    nodes = nodes_of(settings)
    finished(nodes)
    assert digest(tmp_path / "station.db") == before
    for node in nodes[1:]:
        assert node.statuses["source"].state["resumed_scans"] == 40
        assert node.statuses["mapping"].counts == {}


def test_services_that_are_started_afresh_change_nothing(logs: dict[str, Path], tmp_path: Path) -> None:
    """Each of a robot's, and the station's, again and again while all map."""
    settings = settings_of(logs, tmp_path)
    nodes = nodes_of(settings)
    ended = threading.Event()

    def disturb() -> None:
        while not ended.wait(0.3):
            for node in nodes:
                for service in node.supervisor.names:
                    contract = node.statuses["orchestration"].contract or "terrafuse/robot-orchestration/1"
                    if service in ("source", "mapping", "exchange", "map-manager"):
                        node.supervisor.send("orchestration", Message(contract, "restart", service.encode()))
            if sum(node.statuses["mapping"].restarts for node in nodes[1:]) >= 6:
                return

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        finished(nodes)
    finally:
        ended.set()
        thread.join()
    assert sum(status.restarts for node in nodes for status in node.statuses.values()) > 0
    assert digest(tmp_path / "station.db") == mapped_at_once(settings, tmp_path)


def test_what_is_stopped_goes_on(logs: dict[str, Path], tmp_path: Path) -> None:
    settings = settings_of(logs, tmp_path)
    nodes = nodes_of(settings)
    stop = threading.Event()
    threading.Timer(0.7, stop.set).start()
    started = time.monotonic()
    run(nodes, stop)
    assert time.monotonic() - started < 0.7 + 2.0
    finished(nodes_of(settings))
    assert digest(tmp_path / "station.db") == mapped_at_once(settings, tmp_path)


def test_a_robot_of_another_map_is_told(logs: dict[str, Path], tmp_path: Path) -> None:
    settings = settings_of({"r1": logs["r1"]}, tmp_path)
    other = settings_of({"r1": logs["r1"]}, tmp_path, resolution_m=0.4)
    carry = carrier(settings, lambda text: None)
    nodes = [make_node(settings, "station", carry), make_node(other, "r1", carry)]
    with pytest.raises(InputError, match=r"'station' does not take this robot's map.*0\.4 m.*0\.2 m"):
        finished(nodes)


@pytest.mark.parametrize(("robots", "stations"), [(10, 1), (1, 10), (5, 10)])
def test_a_robot_of_another_coarse_map_is_told(
    logs: dict[str, Path], tmp_path: Path, robots: int, stations: int
) -> None:
    """It would wait for a station to take what that has no map for, or leave its coarse map without a part."""
    settings, other = (settings_of({"r1": logs["r1"]}, tmp_path, global_factor=n) for n in (stations, robots))
    carry = carrier(settings, lambda text: None)
    nodes = [make_node(settings, "station", carry), make_node(other, "r1", carry)]
    with pytest.raises(InputError, match=f"map: it has --global-factor {robots}, and 'station' {stations}; make them"):
        finished(nodes)


def test_what_is_no_word_of_a_map_is_counted(tmp_path: Path) -> None:
    settings, hub = settings_of({}, tmp_path), MemoryHub()
    node = make_node(settings, "station", lambda name: lambda: hub.link(name))
    map_ = {"model": "elevation", "resolution_m": 0.2, "tile_m": 40.0, "crs": None}
    more = ({"settings": 5}, {"settings": {}, "global_factor": "10"})
    wrong = [b"", b"{", b"[]", b"7", b"{}", *(json.dumps({"map": map_, **some}).encode() for some in more)]
    node.supervisor.start()
    peers = [Courier(hub.link(f"r{k}"), peers=["station"]) for k in range(len(wrong))]
    for peer, payload in zip(peers, wrong, strict=True):
        peer.post("station", "map-manager terrafuse/map-manager/1 join ", payload)
    deadline = time.monotonic() + 30
    while node.statuses["map-manager"].counts.get("refused.join", 0) < len(wrong) and time.monotonic() < deadline:
        for peer in peers:
            peer.tick(time.time_ns())
        time.sleep(0.02)
    status = node.statuses["map-manager"]
    assert (status.counts.get("refused.join"), status.restarts) == (len(wrong), 0)
    assert node.supervisor.stop(10)
    node.close()


def test_a_station_keeps_to_its_map(logs: dict[str, Path], tmp_path: Path) -> None:
    nodes = [make_node(settings_of({}, tmp_path), "station", carrier(settings_of({}, tmp_path), print))]
    for node in nodes:
        node.close()
    hold_something(tmp_path / "station.db")
    other = settings_of({}, tmp_path, resolution_m=0.4)
    with pytest.raises(StoreMismatch, match=r"station\.db: holds a map of elevation, cells of 0\.2 m"):
        make_node(other, "station", carrier(other, print))


def test_a_log_without_a_scan_is_an_error(tmp_path: Path, logs: dict[str, Path]) -> None:
    settings = settings_of({"r1": logs["r1"]}, tmp_path, model_settings={"max_range_m": 0.001})
    with pytest.raises(InputError, match="puts nothing on the map"):
        finished(nodes_of(settings))


def test_a_station_keeps_to_its_coarse_map(tmp_path: Path) -> None:
    before, after = (settings_of({}, tmp_path, global_factor=factor) for factor in (5, 10))
    make_node(before, "station", carrier(before, print)).close()
    hold_something(tmp_path / "station.coarse.db")
    with pytest.raises(StoreMismatch, match=r"station\.coarse\.db: is of another map than asked for; delete it"):
        make_node(after, "station", carrier(after, print))


def test_a_station_takes_no_ones_report_of_another(logs: dict[str, Path], tmp_path: Path) -> None:
    """A node that passes on what it says is r1's, as only a station may."""
    settings = settings_of({"r1": logs["r1"]}, tmp_path)
    hub = MemoryHub()
    nodes = [make_node(settings, name, lambda node: lambda: hub.link(node)) for name in ("station", "r1")]
    forged = MemoryStore(Lattice(0.2, 40.0), model := make_model("elevation"))
    for delta in deltas_of("r1", random_scans(1, 3), Lattice(0.2, 40.0), model):
        forged.accept(delta)
    evil = Courier(hub.link("evil"), [Channel("fine", forged, relay=True)], peers=["station"])
    station = nodes[0]
    station.supervisor.start()
    deadline = time.monotonic() + 20
    while not station.statuses["map-manager"].counts.get("refused.sender"):
        assert time.monotonic() < deadline, station.statuses["map-manager"]
        evil.tick(time.time_ns())
        time.sleep(0.02)
    assert station.supervisor.stop(5)
    for node in nodes:
        node.close()
    with SqliteStore.open(tmp_path / "station.db") as store:
        assert store.robots() == []


def test_a_store_that_holds_nothing_takes_other_settings(logs: dict[str, Path], tmp_path: Path) -> None:
    """Who mistyped the first time can type again; what holds a map is not touched."""
    first = settings_of({"r1": logs["r1"]}, tmp_path, resolution_m=0.5)
    for node in nodes_of(first):
        node.close()
    second = settings_of({"r1": logs["r1"]}, tmp_path)
    nodes = nodes_of(second)
    finished(nodes)
    held = digest(tmp_path / "station.db")
    for name, why in (("station", "choose another store"), ("r1", "choose another --store")):
        with pytest.raises(StoreMismatch, match=why):
            make_node(first, name, carrier(first, lambda text: None))
    assert digest(tmp_path / "station.db") == held
