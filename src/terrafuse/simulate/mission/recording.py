"""Logs of a mission, and what `terrafuse map` has to be told to make the same map of them."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.scenario import Loaded

SENSOR = """# What {name}.mcap does not hold of the sensor; where it sits, /tf_static says.
name: {sensor}
max_range_m: {max_range_m:.17g}
"""


def check_can_record(loaded: Loaded) -> None:
    """Raise InputError, with the line, for robots whose sensors a log of points can't hold."""
    for index, part in enumerate(loaded.scenario.robots):
        if len(part.sensors) > 1:
            raise loaded.error(
                ("robots", index, "sensors", 1), "a log holds one lidar a robot; keep one, or leave --record out"
            )
        if part.sensors[0].kind != "lidar":
            raise loaded.error(
                ("robots", index, "sensors", 0),
                f"a log holds points, and a {part.sensors[0].kind} has cones; give it a lidar, or leave --record out",
            )


def write_sensors(mission: Mission, out: Path) -> dict[str, str]:
    """A description beside each robot's log; returns all the files by what they are."""
    files: dict[str, str] = {}
    for vehicle in mission.vehicles:
        sensor, name = vehicle.senses[0].sensor, vehicle.name
        text = SENSOR.format(
            name=name, sensor=json.dumps(sensor.name, ensure_ascii=False), max_range_m=sensor.max_range_m
        )
        (out / f"{name}.sensor.yaml").write_text(text, encoding="utf-8")
        files |= {f"log of {name}": f"{name}.mcap", f"sensor of {name}": f"{name}.sensor.yaml"}
    return files


def map_command(report: Mapping[str, Any], folder: Path) -> str:
    """What makes the map of a recorded mission of its logs."""
    part, about, names = report["scenario"]["map"], report["map"], list(report["robots"])
    settings = "&".join(f"{key}={value}" for key, value in part["settings"].items())
    words = ["terrafuse", "map", *(f"{name}={folder / name}.mcap" for name in names)]
    for name in names:
        words += ["--sensor", f"{name}={folder / name}.sensor.yaml"]
    words += ["--model", f"{about['model']}?{settings}" if settings else about["model"]]
    words += ["--resolution", repr(about["resolution_m"]), "--tile", repr(about["tile_m"])]
    if about["crs"] is not None:
        words += ["--crs", about["crs"]]
    if "prior" in report["files"]:
        words += ["--prior", str(folder / report["files"]["prior"])]
    return shlex.join([*words, "--out", str(folder / "again")])
