"""A mission's report as one HTML page, and the tables that every mission has."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from terrafuse.export.page import boxes, figure, section, write_page
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.exchange import STATION
from terrafuse.simulate.mission.tables import Cell, Table, from_json, html

Report = Mapping[str, Any]
CAPTIONS = {
    "world": "The world as it is, and where the robots truly went. Triangle: the station.",
    "map": "The map of all robots together, with the paths that they believed in.",
    "global": "The global map as the station has it: coarser, from what robots reported over the radio.",
    "whole map": "The map of the station, and the robots where they say that they are.",
}
FILM_CAPTION = "The station's global map as it grows. Pale: known beforehand, seen by nobody yet."


def write_html(path: Path, report: Report, folder: Path) -> None:
    """Write the page of a report (as in report.json), with the pictures in the folder. Raises OutputError."""
    scenario = report["scenario"]
    about = f"terrafuse {report['terrafuse']} · terrafuse simulate {scenario['name']} · seed {report['seed']}"
    write_page(path, scenario["title"] or scenario["name"], about, _parts(report, folder))


def _parts(report: Report, folder: Path) -> Iterator[str]:
    yield boxes(_first_facts(report))
    yield figure(folder / report["files"]["film"], "The map as it grows", FILM_CAPTION)
    for name, file in report["files"].items():
        if name in CAPTIONS:
            yield figure(folder / file, name, CAPTIONS[name])
    for table in tables_of(report):
        yield html(table)
    yield section("Robots' own maps", "".join(_own_maps(report, folder)))
    yield html(_settings(report))
    yield html(Table("Files", ("what", "file"), tuple(report["files"].items())))


def tables_of(report: Report) -> list[Table]:
    """All tables of a report: its study's, then those that every mission has."""
    timings = report["timings"]["tables"]
    studied = [from_json(table) for table in (*report["tables"], *timings)]
    return [
        *studied,
        robots_table(report),
        measures_table(report),
        windows_table(report),
        radio_table(report),
        nodes_table(report),
    ]


def _first_facts(report: Report) -> dict[str, str]:
    robots, timings = report["robots"].values(), report["timings"]
    return {
        "robots": str(len(robots)),
        "simulated": f"{report['simulated_s']:,.0f} s",
        "mapped at the station": f"{report['mapped_share']:.1%}",
        "times real time": f"{timings['times_real_time']:.1f}",
        "points": f"{sum(robot['points'] for robot in robots):,}",
        "driven": f"{sum(robot['way_m'] for robot in robots) / 1000:.2f} km",
        "cells known": f"{report['cells']:,}",
    }


def _own_maps(report: Report, folder: Path) -> Iterator[str]:
    for name, file in report["files"].items():
        if name.startswith("map of "):
            yield figure(folder / file, name, f"What {name.removeprefix('map of ')} saw itself.")


def robots_table(report: Report) -> Table:
    """What became of each robot."""
    return Table(
        "Robots",
        ("robot", "scans", "points", "way, m", "pose RMSE, m", "largest, m", "mean NEES", "sensors' false echoes"),
        tuple(
            (
                name, robot["scans"], robot["points"], robot["way_m"], robot["pose"].get("rms_error_m"),
                robot["pose"].get("largest_error_m"), robot["pose"].get("mean_nees"),
                sum(sensor.get("false_echoes", 0) for sensor in robot["sensors"]),
            )
            for name, robot in report["robots"].items()
        ),
        "Errors of the pose that the robot maps with, against the truth; NEES of a consistent filter is about 4.",
    )  # fmt: skip


def windows_table(report: Report) -> Table:
    """What the robots' windows claimed, what of it was seen, what paging cost."""
    return Table(
        "Windows",
        ("robot", "cells in the window", "observed of these", "cells allocated", "observed of these",
         "most tiles at once", "loads", "writes"),
        tuple(
            (
                name, held["window_cells"], held["observed_of_window"], held["allocated_cells"],
                held["observed_of_allocated"], robot["paging"]["most_resident"], robot["paging"]["loads"],
                robot["paging"]["writes"],
            )
            for name, robot in report["robots"].items()
            for held in [robot["allocation"]]
        ),
    )  # fmt: skip


def radio_table(report: Report) -> Table:
    """What each node's radio sent and received."""
    return _counts_table("Radio", report["radio"])


def nodes_table(report: Report) -> Table:
    """What each node's courier sent and received, by kind."""
    robots = {name: robot["exchange"] for name, robot in report["robots"].items()}
    return _counts_table("Exchange", {STATION: report["station"], **robots})


def _counts_table(title: str, counts: Mapping[str, Mapping[str, int]]) -> Table:
    """A row for each node, a column for each count that any has."""
    names = sorted({name for several in counts.values() for name in several})
    rows: list[tuple[Cell, ...]] = [
        (node, *(several.get(name, 0) for name in names)) for node, several in counts.items()
    ]
    return Table(title, ("node", *(name.replace("_", " ") for name in names)), tuple(rows) if names else ())


def measures_table(report: Report) -> Table:
    """The maps against the truth, a measure a row."""
    both = {which: dict(_flat(report["measures"][which])) for which in ("map", "global")}
    names = list(dict.fromkeys([*both["map"], *both["global"]]))
    resolutions = report["map"]["resolution_m"], report["global"]["map"]["resolution_m"]
    return Table(
        "Against the truth",
        (
            "measure",
            *(f"{word}, {metres:g} m" for word, metres in zip(("robots' map", "station's"), resolutions, strict=True)),
        ),
        tuple((name, both["map"].get(name), both["global"].get(name)) for name in names),
        "Of what robots saw, the prior left out. Ghosts stand over 0.5 m higher than anything within a cell of them; "
        "obstacles are false, or missed, if there is none within a cell.",
    )


def _flat(facts: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Cell]]:
    for name, value in facts.items():
        words = before + name.replace("_", " ")
        if isinstance(value, Mapping):
            yield from _flat(value, f"{words}: ")
        elif isinstance(value, list):
            yield from ((f"{words} {k}", one) for k, one in enumerate(value, start=1))
        else:
            yield words, value


def stage_table(mission: Mission) -> Table:
    """Milliseconds of clock time by stage and robot, a scan in the mean."""
    stages = list(dict.fromkeys(stage for vehicle in mission.vehicles for stage in _stages(vehicle)))
    rows: list[tuple[Cell, ...]] = []
    for vehicle in mission.vehicles:
        seconds, scans = _stages(vehicle), max(vehicle.mapper.revision, 1)
        rows.append((vehicle.name, *(1e3 * seconds[stage] / scans if stage in seconds else None for stage in stages)))
    ticks = max(round(mission.now_s / mission.scenario.tick_s), 1)
    return Table(
        "Milliseconds a scan, by stage",
        ("robot", *stages),
        tuple(rows),
        "'map' is observe, load, merge and evict; 'coarsen' is part of 'exchange'. The station takes "
        f"{1e3 * mission.station.seconds / ticks:.3g} ms a tick of {mission.scenario.tick_s:g} s.",
    )


def _stages(vehicle: Any) -> dict[str, float]:
    return {**vehicle.seconds, **vehicle.mapper.seconds, **vehicle.node.seconds}


def _settings(report: Report) -> Table:
    rows = _flat({key: value for key, value in report["scenario"].items() if key != "robots"})
    kinds = (
        (f"robots {k}", json.dumps(part, ensure_ascii=False))
        for k, part in enumerate(report["scenario"]["robots"], start=1)
    )
    shown = tuple((name, value if isinstance(value, str) else json.dumps(value)) for name, value in (*rows, *kinds))
    return Table("Scenario", ("setting", "value"), shown)
