"""Robots hold the station's map where they are interested."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from terrafuse.cli.running import progress
from terrafuse.exchange.area import meets
from terrafuse.replica import Replica
from terrafuse.services.node import _area
from terrafuse.services.places import Place
from terrafuse.services.settings import FleetSettings, RobotPart, StationPart
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Bounds
from tests.program import terrafuse
from tests.services.test_one_process import finished, nodes_of, settings_of

AREA = (0.0, 0.0, 30.0, 30.0)


def test_an_area_may_go_with_the_robot() -> None:
    here = Place(0, 10.0, 20.0, 0.0)
    part = RobotPart(source="a", store="b", area_radius_m=5.0)
    assert _area(part)(None) is None
    assert _area(part)(here) == Bounds(5.0, 15.0, 15.0, 25.0)
    both = part.model_copy(update={"area_m": (0.0, 0.0, 1.0, 1.0)})
    assert _area(both)(None) == Bounds(0.0, 0.0, 1.0, 1.0)
    assert _area(both)(here) == Bounds(0.0, 0.0, 15.0, 25.0)


@pytest.mark.parametrize("area", [(0, 0, 1e12, 1e12), (0, 0, 1e-9, 1e-9), (5, 5, 1, 9), (1e9, 0, 1e9 + 50, 50)])
def test_an_area_that_no_robot_can_mean_is_refused(area: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="sides of 1 m to 100 km"):
        RobotPart(source="a", store="b", area_m=area)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="sides of 1 m to 100 km"):
        StationPart(store="b", upstream=("x",), area_m=area)  # type: ignore[arg-type]


def test_the_command_says_so(tmp_path: Path) -> None:
    for option in ("--area", "0,0,1e12,1e12"), ("--area", "0,0,1e-9,1e-9"), ("--area-radius", "1e12"):
        ran = terrafuse("robot", "r1", "--source", str(tmp_path), "--insecure", "--connect", "tcp/127.0.0.1:1", *option)
        assert ran.code == 2
        assert "100 km" in ran.err or "50000" in ran.err


def interested(settings: FleetSettings) -> FleetSettings:
    first = settings.robots["r1"].model_copy(update={"area_m": AREA, "share": "none"})
    return settings.model_copy(update={"robots": settings.robots | {"r1": first}})


def alike(folder: Path) -> bool:
    """Whether r1 holds of its area what the station folds, and nothing else."""
    with SqliteStore.open(folder / "station.db") as store, SqliteStore.open(folder / "r1.global.db") as near:
        station, robot = Replica(store=store), Replica(store=near)
        inside = [key for key in station.keys if meets(key, store.map.tile_m, Bounds(*AREA))]
        bare = [name for name in station.model.cell.names if name != "revision"]
        return sorted(robot.keys) == sorted(inside) and all(
            np.array_equal(station.cells(key)[bare], robot.cells(key)[bare]) for key in inside
        )


def test_a_robot_holds_the_stations_map_of_its_area(logs: dict[str, Path], tmp_path: Path) -> None:
    settings = interested(settings_of(logs, tmp_path))
    nodes = nodes_of(settings)
    for node in nodes:
        node.supervisor.start(node.name)
    deadline = time.monotonic() + 90
    try:
        while not (all(node.done for node in nodes[1:]) and alike(tmp_path)):
            assert time.monotonic() < deadline
            time.sleep(0.5)
            if nodes[1].done and not alike(tmp_path):
                nodes[1].supervisor.restart("exchange")  # it ends when all of its own is at the station
    finally:
        for node in nodes:
            node.supervisor.stop(5)
            node.close()


def test_a_robot_is_told_that_its_area_is_too_large(logs: dict[str, Path], tmp_path: Path) -> None:
    settings = interested(settings_of(logs, tmp_path))
    assert settings.station is not None
    quotas = settings.station.quotas.model_copy(update={"area_tiles": 1})
    station = settings.station.model_copy(update={"quotas": quotas})
    wide = settings.robots["r1"].model_copy(update={"area_m": (-50.0, -50.0, 50.0, 50.0)})
    robots = settings.robots | {"r1": wide}
    nodes = nodes_of(settings.model_copy(update={"station": station, "robots": robots}))
    finished(nodes)
    assert "more tiles than a robot may ask for" in nodes[1].statuses["exchange"].state["said"]["station"]
    assert "station says: the area of interest (-50.0, -50.0, 50.0, 50.0)" in progress(nodes[1])
    assert nodes[0].statuses["map-manager"].counts["refused.area"] == 1
    with SqliteStore.open(tmp_path / "r1.global.db") as near:
        assert near.keys() == []
