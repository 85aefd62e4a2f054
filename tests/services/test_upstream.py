"""Stations above stations: the upper one's map is that of all logs."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.exchange.channel import Channel
from terrafuse.exchange.courier import Courier, CourierSettings
from terrafuse.exchange.links import MemoryHub
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.services.gate import Gate
from terrafuse.services.settings import QuotasPart, StationPart
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.relay import Relay
from tests.program import terrafuse
from tests.services.drives import drive
from tests.services.processes import Processes, answers, cells_in, digest, free_port

LATTICE, MODEL = Lattice(0.5, 4.0), make_model("elevation")
QUICK = CourierSettings(period_s=0.5, answer_s=0.1, retry_s=0.5)


def test_what_only_tells_takes_nothing_and_tells_what_others_write() -> None:
    hub = MemoryHub()
    below, above = (MemoryStore(LATTICE, MODEL) for _ in range(2))
    for delta in deltas_of("r9", random_scans(9, 2), LATTICE, MODEL):
        above.accept(delta)
    yard = Courier(hub.link("yard"), [Channel("fine", below, relay=True, deaf=True)], settings=QUICK)
    city = Courier(hub.link("city"), [Channel("fine", above, relay=True)], settings=QUICK)
    deltas = deltas_of("r1", random_scans(1, 6), LATTICE, MODEL)
    for k in range(200):
        if k % 20 == 0 and deltas:
            below.accept(deltas.pop(0))
        yard.tick(k * 100_000_000)
        city.tick(k * 100_000_000)
    assert below.robots() == ["r1"]
    assert above.robots() == ["r1", "r9"]
    assert Replica(store=above, only=["r1"]).digest() == Replica(store=below).digest()
    assert yard.behind("city") == {}
    assert city.counts["bytes_sent.delta"] == 0


def test_who_may_relay() -> None:
    store = MemoryStore(LATTICE, MODEL)
    (delta,) = deltas_of("r1", random_scans(1, 1), LATTICE, MODEL)
    now_ns = delta.stamp_ns + 1
    for relays, reason in (((), "sender"), (("yard",), None)):
        guard = Gate([store], QuotasPart(), None, relays).channel("fine", 0, store).guard
        assert guard is not None
        assert guard("yard", delta, now_ns, 1000) == reason
    with pytest.raises(InputError, match="terrafuse keys add NAME --station"):
        Gate([store], QuotasPart(), "keys", ("yard",))


def test_settings_that_make_no_sense() -> None:
    with pytest.raises(ValueError, match="both called 'station'"):
        StationPart(store="s.db", upstream=("tcp/10.0.0.1",))
    with pytest.raises(ValueError, match="the map of a station above"):
        StationPart(store="s.db", area_m=(0, 0, 1, 1))


def test_two_stations_below_one(tmp_path: Path) -> None:
    """One of them can't reach the upper one while its robot maps; it may hold that one's map then."""
    pytest.importorskip("zenoh")
    logs = {"r1": drive(tmp_path / "log1", 1), "r2": drive(tmp_path / "log2", 2)}
    options = ["--resolution", "0.2", "--global-factor", "10"]
    ran = terrafuse(
        "map", *(f"{name}={log}" for name, log in logs.items()), *options, "--out", tmp_path / "m", "--json"
    )
    assert ran.code == 0, ran.err
    city, yard, port = free_port(), free_port(), free_port()
    upper, relayed = f"127.0.0.1:{city}", f"127.0.0.1:{free_port()}"
    with Processes(tmp_path) as fleet:

        def station(name: str, port: int, *more: str) -> None:
            listen = f"tcp/127.0.0.1:{port}"
            fleet.start(
                name,
                "station",
                "--name",
                name,
                "--store",
                f"{name}.db",
                "--listen",
                listen,
                "--insecure",
                *options,
                *more,
            )
            fleet.until(lambda: answers(port), f"that {name} listens")

        station("city", city, "--relay", "yard", "--relay", "port")
        above = ["--upstream-station", "city", "--upstream"]
        with Relay(upper, listen=relayed):
            station("yard", yard, *above, f"tcp/{relayed}", "--area=-50,-50,50,50")
            station("port", port, *above, f"tcp/{upper}")
            fleet.until(lambda: '"yard' in listed(city), "that the upper one knows yard")
        # The link is cut: r1 ends all the same.
        for name, at, below in (("r1", yard, "yard"), ("r2", port, "port")):
            fleet.start(
                name, "robot", name, "--connect", f"tcp/127.0.0.1:{at}", "--station", below, "--source", logs[name],
                "--insecure", *options,
            )  # fmt: skip
        fleet.until(lambda: None not in map(fleet.code, logs), "that the robots end")
        assert [fleet.code(name) for name in logs] == [0, 0]
        fleet.until(lambda: cells_in(tmp_path / "city.db") > 0, "that the upper one holds r2's")
        assert digest(tmp_path / "city.db") != ran.json["map"]["digest"]
        with Relay(upper, listen=relayed):
            fleet.until(
                lambda: digest(tmp_path / "city.db") == ran.json["map"]["digest"], "that the upper one holds all"
            )
            fleet.until(
                lambda: digest(tmp_path / "city.coarse.db") == digest(tmp_path / "m" / "map.db", 10), "coarse, too"
            )
            fleet.until(
                lambda: (
                    (tmp_path / "yard.global.db").exists()
                    and digest(tmp_path / "yard.global.db") == ran.json["map"]["digest"]
                ),
                "that yard holds the map of the upper one",
            )
        assert digest(tmp_path / "yard.db") != ran.json["map"]["digest"]
        lower = ["--connect", f"tcp/127.0.0.1:{yard}", "--station", "yard", "--insecure", "--json"]
        known = terrafuse("services", *lower)
        assert known.code == 0, known.err
        assert {"yard", "r1"} <= {node["node"] for node in known.json["nodes"]}
        shown = terrafuse("get", "yard/map-manager", *lower)
        assert shown.json["state"]["channels"]["fine"].keys() == {"r1"}
        part = terrafuse("get", "yard/map-manager", "--layer", "height", "--out", tmp_path / "y.png", *lower)
        assert part.code == 0, part.err
        assert [fleet.stop(name)[0] for name in ("yard", "port", "city")] == [0, 0, 0]


def listed(port: int) -> str:
    ran = terrafuse("services", "--connect", f"tcp/127.0.0.1:{port}", "--station", "city", "--insecure", "--json")
    return ran.out if ran.code == 0 else ""
