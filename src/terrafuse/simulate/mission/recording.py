"""Logs of a mission, and what `terrafuse map` has to be told to make the same map of them."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from terrafuse.sense import Sensor
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.senses import as_logged
from terrafuse.simulate.scenario import Loaded

ABOUT = """# What {name}.mcap does not hold of the sensor; where it sits, /tf_static says.
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
        lines = (f"{key}: {json.dumps(value, ensure_ascii=False)}\n" for key, value in description(sensor).items())
        (out / f"{name}.sensor.yaml").write_text(ABOUT.format(name=name) + "".join(lines), encoding="utf-8")
        files |= {f"log of {name}": f"{name}.mcap", f"sensor of {name}": f"{name}.sensor.yaml"}
    return files


def description(sensor: Sensor) -> dict[str, Any]:
    """Of a recorded sensor, by the keys of sensor files, what of it is not as by default: see `senses.as_logged`."""
    about = as_logged(sensor)
    out: dict[str, Any] = {"name": about.name, "max_range_m": about.max_range_m}
    plain = Sensor("", 1.0)
    for key in ("no_return", "origin_m", "cone_half_angle_rad", "range_error_m", "reliability"):
        if getattr(about, key) != getattr(plain, key):
            out[key] = getattr(about, key)
    if about.radius_m:
        out["ring"] = {"count": 1, "radius_m": about.radius_m}
    return out


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
    return shlex.join([*words, "--out", str(folder / "again"), "--overwrite"])
