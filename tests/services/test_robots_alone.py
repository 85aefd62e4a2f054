"""Robots without a station come to one map among themselves."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse.services.settings import FleetSettings
from tests.program import terrafuse
from tests.services.drives import drive
from tests.services.processes import Processes, answers, cells_in, digest, free_port


def mapped(logs: dict[str, str], options: list[str], folder: Path) -> str:
    ran = terrafuse("map", *(f"{name}={log}" for name, log in logs.items()), *options, "--out", folder, "--json")
    assert ran.code == 0, ran.err
    found: str = ran.json["map"]["digest"]
    return found


def test_three_robots_one_of_which_listens(tmp_path: Path) -> None:
    """That one is killed while it maps."""
    pytest.importorskip("zenoh")
    logs = {f"r{k}": drive(tmp_path / f"log{k}", k) for k in (1, 2, 3)}
    options, port = ["--resolution", "0.2"], free_port()
    expected = mapped(logs, options, tmp_path / "map")
    with Processes(tmp_path) as fleet:
        for name, log in logs.items():
            where = ["--listen" if name == "r1" else "--connect", f"tcp/127.0.0.1:{port}", "--insecure"]
            peers = [word for other in logs if other != name for word in ("--peer", other)]
            pace = ["--realtime"] if name == "r1" else []
            fleet.start(name, "robot", name, *where, *peers, "--source", log, *pace, *options)
            fleet.until(lambda: answers(port), "that r1 listens")
        fleet.until(lambda: cells_in(tmp_path / "r1.db") > 0, "that r1 maps")
        fleet.kill("r1")
        fleet.again("r1")
        fleet.until(lambda: None not in map(fleet.code, logs), "that all end")
        assert [fleet.code(name) for name in logs] == [0, 0, 0]
        assert "all is at r2, r3" in fleet.text("r1")
    assert [digest(tmp_path / f"{name}.replica.db") for name in logs] == [expected] * 3


def test_robots_of_other_maps_are_told(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    port = free_port()
    with Processes(tmp_path) as fleet:
        for name, where, other, cell in (("r1", "--listen", "r2", "0.2"), ("r2", "--connect", "r1", "0.4")):
            fleet.start(
                name, "robot", name, where, f"tcp/127.0.0.1:{port}", "--insecure", "--peer", other,
                "--source", drive(tmp_path / f"log-{name}"), "--resolution", cell,
            )  # fmt: skip
            fleet.until(lambda: answers(port), "that r1 listens")
        fleet.until(lambda: None not in (fleet.code("r1"), fleet.code("r2")), "that both end")
        assert {fleet.code("r1"), fleet.code("r2")} <= {2, 0}
        assert "cells of 0.4 m" in fleet.text("r1") + fleet.text("r2")


def test_settings_that_make_no_sense(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'r1' is its own peer"):
        FleetSettings.model_validate({"robots": {"r1": {"source": "a", "store": "b", "peers": ["r1"]}}})
    ran = terrafuse("robot", "r1", "--source", drive(tmp_path / "log"), "--insecure")
    assert ran.code == 2
    assert "--listen ADDRESS for other robots" in ran.err
