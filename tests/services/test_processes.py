"""Real processes on a network that stalls and cuts, some of them killed: the map is that of `terrafuse map`."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from terrafuse.testing.relay import Mishaps, Relay
from tests.program import terrafuse
from tests.services.cut import ROBOTS, freiburg, kitti
from tests.services.processes import Processes, answers, cells_in, digest, free_port

pytest.importorskip("zenoh")

MISHAPS = Mishaps(stall=0.1, cut=0.2, within_s=4.0)
"""Three in ten connections. A stalled one is only given up after ten seconds without a sign of life."""
SEED = 393
"""Of the first 20 connections 6 go wrong; of the first three, one is stalled after 1.1 s, one cut after 0.1 s."""


def mapped(sources: dict[str, str], options: list[str], folder: Path) -> str:
    ran = terrafuse("map", *(f"{name}={log}" for name, log in sources.items()), *options, "--out", folder, "--json")
    assert ran.code == 0, ran.err
    digest_: str = ran.json["map"]["digest"]
    return digest_


def through_faults(sources: dict[str, str], options: list[str], budget: int, folder: Path) -> None:
    """The station is killed twice, a robot once; each time there is more to come."""
    expected = mapped(sources, options, folder / "at once")
    run = folder / "run"
    run.mkdir()
    port, store = free_port(), run / "station.db"
    with Relay(f"127.0.0.1:{port}", MISHAPS, SEED) as relay, Processes(run) as fleet:
        listen = f"tcp/127.0.0.1:{port}"
        fleet.start("station", "station", "--store", store, "--listen", listen, "--insecure", *options)
        fleet.until(lambda: answers(port), "that the station listens")
        for name in ROBOTS:
            fleet.start(
                name, "robot", name, "--connect", f"tcp/{relay.address}", "--source", sources[name], "--insecure",
                "--budget", str(budget), "--share", "none", *options,
            )  # fmt: skip
        for round_ in range(2):
            seen = cells_in(store)
            fleet.until(lambda seen=seen: cells_in(store) > seen, "that the station takes more in")  # type: ignore[misc]
            fleet.kill("station")
            if round_ == 0:
                fleet.until(lambda: cells_in(run / "r2.db") > 0, "that r2 maps")
                fleet.kill("r2")
                fleet.again("r2")
            fleet.again("station")
        fleet.until(lambda: all(fleet.code(name) is not None for name in ROBOTS), "that all robots end")
        assert [fleet.code(name) for name in ROBOTS] == [0, 0, 0]
        assert fleet.stop("station")[0] == 0
        assert relay.counts["stalled"] >= 1
        assert relay.counts["cut"] >= 1
        assert digest(store) == expected


def test_kitti_in_three(recordings: Path, tmp_path: Path) -> None:
    through_faults(kitti(recordings, tmp_path), ["--resolution", "0.4"], 150_000, tmp_path)


@pytest.mark.long
def test_freiburg_in_three(recordings: Path, tmp_path: Path) -> None:
    options = ["--model", "occupancy", "--resolution", "0.1"]
    through_faults(freiburg(recordings, tmp_path, every=20), options, 30_000, tmp_path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stopped_in_time_with_all_on_disk(logs: dict[str, Path], tmp_path: Path, number: signal.Signals) -> None:
    """In the middle of mapping, first while nobody answers, then on the way to the station."""
    options, port, store = ["--resolution", "0.2"], free_port(), tmp_path / "station.db"
    expected = mapped({"r1": str(logs["r1"])}, options, tmp_path / "at once")
    robot = ["robot", "r1", "--connect", f"tcp/127.0.0.1:{port}", "--source", logs["r1"], "--insecure", *options]
    with Processes(tmp_path) as fleet:
        fleet.start("r1", *robot, "--realtime")
        fleet.until(lambda: cells_in(tmp_path / "r1.db") > 0, "that r1 maps")
        code, seconds = fleet.stop("r1", number)
        assert (code, seconds < 2.0) == (130, True), seconds
        kept = cells_in(tmp_path / "r1.db")
        fleet.start("station", "station", "--store", store, "--listen", f"tcp/127.0.0.1:{port}", "--insecure", *options)
        fleet.start("r1", *robot, "--budget", "100000")
        fleet.until(lambda: cells_in(store) > 0, "that the station takes it in")
        code, seconds = fleet.stop("r1", number)
        assert (code, seconds < 2.0) == (130, True), seconds
        assert cells_in(tmp_path / "r1.db") >= kept > 0
        code, seconds = fleet.stop("station", number)
        assert (code, seconds < 2.0) == (0, True), seconds
        fleet.again("station")
        fleet.start("r1", *robot)
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends")
        assert fleet.code("r1") == 0
        fleet.stop("station", number)
        assert digest(store) == expected


FLEET = """
# Two robots and their station. `terrafuse fleet fleet.yaml` runs all three in one process.
map:
  resolution_m: 0.2
link:
  kind: {kind}              # memory: one process; zenoh: as many as are wanted
  listen: [tcp/127.0.0.1:{port}]
  connect: [tcp/127.0.0.1:{port}]
  insecure: true
station:
  store: {folder}/station.db
robots:
  r1:
    source: {r1}
    store: {folder}/r1.db
  r2:
    source: {r2}
    store: {folder}/r2.db
"""


def test_one_process_or_many_by_configuration_alone(logs: dict[str, Path], tmp_path: Path) -> None:
    expected = mapped({name: str(log) for name, log in logs.items()}, ["--resolution", "0.2"], tmp_path / "at once")
    for kind, groups in {"memory": [[]], "zenoh": [["station"], ["r1"], ["r2"]]}.items():
        folder = tmp_path / kind
        folder.mkdir()
        file = folder / "fleet.yaml"
        file.write_text(FLEET.format(kind=kind, port=free_port(), folder=folder, **logs))
        with Processes(folder) as fleet:
            for nodes in groups:
                chosen = [word for name in nodes for word in ("--node", name)]
                fleet.start("+".join(nodes) or "all", "fleet", file, *chosen)
            ending = ["all"] if kind == "memory" else ["r1", "r2"]
            fleet.until(lambda fleet=fleet, ending=ending: None not in map(fleet.code, ending), "that all end")  # type: ignore[misc]
            assert [fleet.code(name) for name in ending] == [0] * len(ending)
            if kind == "zenoh":
                assert fleet.stop("station")[0] == 0
            assert digest(folder / "station.db") == expected


def test_services_are_listed_and_asked(logs: dict[str, Path], tmp_path: Path) -> None:
    port, options = free_port(), ["--resolution", "0.2"]
    where = ["--connect", f"tcp/127.0.0.1:{port}", "--insecure"]
    with Processes(tmp_path) as fleet:
        fleet.start("station", "station", "--store", "s.db", "--listen", where[1], "--insecure", *options)
        fleet.start("r1", "robot", "r1", *where, "--source", logs["r1"], "--realtime", *options)
        fleet.until(lambda: cells_in(tmp_path / "s.db") > 0, "that the station holds something")
        listed = terrafuse("services", *where, "--json")
        assert listed.code == 0, listed.err
        found = {f"{node['node']}/{one['name']}": one for node in listed.json["nodes"] for one in node["services"]}
        assert found.keys() == {
            "station/map-manager", "station/directory", "station/orchestration",
            "r1/source", "r1/mapping", "r1/exchange", "r1/directory", "r1/orchestration",
        }  # fmt: skip
        assert found["r1/mapping"]["contract"] == "terrafuse/mapping/1"
        assert found["station/map-manager"]["health"] == "running"
        table = terrafuse("services", *where, "--once")
        assert table.code == 0, table.err
        assert all(name in table.out for name in found)
        got = terrafuse("get", "station/map-manager", *where, "--json")
        assert got.code == 0, got.err
        assert got.json["state"]["map"]["resolution_m"] == 0.2
        assert "r1" in got.json["state"]["channels"]["fine"]
        nothing = terrafuse("get", "r9/mapping", *where)
        assert nothing.code == 2
        assert "no service 'r9/mapping'; there are " in nothing.err
        nobody = terrafuse("get", "r9/mapping", "--connect", where[1], "--insecure", "--station", "base")
        assert nobody.code == 1
        assert "'base' does not answer" in nobody.err


def test_another_map_is_refused_with_both_named(logs: dict[str, Path], tmp_path: Path) -> None:
    port = free_port()
    with Processes(tmp_path) as fleet:
        fleet.start("station", "station", "--store", "s.db", "--listen", f"tcp/127.0.0.1:{port}", "--insecure")
        ran = terrafuse(
            "robot", "r1", "--connect", f"tcp/127.0.0.1:{port}", "--source", logs["r1"], "--store", tmp_path / "r1.db",
            "--resolution", "0.2", "--insecure",
        )  # fmt: skip
        assert ran.code == 2
        assert "cells of 0.2 m" in ran.err
        assert "cells of 0.1 m" in ran.err


def test_with_keys(logs: dict[str, Path], tmp_path: Path) -> None:
    """The same over mutual TLS; an operator has a certificate, too, and who has none gets nowhere."""
    pytest.importorskip("cryptography")
    expected = mapped({"r1": str(logs["r1"])}, ["--resolution", "0.2"], tmp_path / "at once")
    assert terrafuse("keys", "new-fleet", "--out", tmp_path / "fleet").code == 0
    for words in (["station", "--station", "--host", "127.0.0.1"], ["r1"], ["ops"]):
        assert terrafuse("keys", "add", *words, "--fleet", tmp_path / "fleet").code == 0
    keys, port = tmp_path / "fleet/nodes", free_port()
    where = ["--connect", f"tls/127.0.0.1:{port}"]
    with Processes(tmp_path) as fleet:
        fleet.start(
            "station", "station", "--store", "s.db", "--listen", where[1], "--keys", keys / "station",
            "--resolution", "0.2",
        )  # fmt: skip
        fleet.until(lambda: answers(port), "that the station listens")
        fleet.start("r1", "robot", "r1", *where, "--source", logs["r1"], "--keys", keys / "r1", "--resolution", "0.2")
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends")
        assert fleet.code("r1") == 0
        listed = terrafuse("services", *where, "--keys", keys / "ops", "--json")
        assert listed.code == 0, listed.err
        assert {node["node"] for node in listed.json["nodes"]} == {"station", "r1"}
        assert terrafuse("services", "--connect", f"tcp/127.0.0.1:{port}").code == 2  # neither keys nor --insecure
        fleet.stop("station")
        assert digest(tmp_path / "s.db") == expected
