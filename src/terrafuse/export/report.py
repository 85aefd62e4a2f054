"""A mapping run as one HTML file that needs nothing else: no scripts, no links, the picture inside."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from terrafuse.export.page import Number, Row, boxes, figure, section, table, write_page


def write_report(path: Path | str, report: Mapping[str, Any], picture: Path | str) -> None:
    """Write the report (see `terrafuse.results.report_of`; keys that are missing are left out) with the PNG `picture`.

    Raises InputError if the picture can't be read, OutputError where the file can't be written.
    """
    image = figure(picture, "The map, seen from above")
    robots = " + ".join(_robots_of(report))
    title = f"Map of {robots}" if robots else "Map"
    write_page(path, title, f"terrafuse {report.get('terrafuse', '')}", _body(report, image))


def _body(report: Mapping[str, Any], image: str) -> list[str]:
    by_robot = {name: robot.get("seconds", {}) for name, robot in _robots_of(report).items()}
    return [
        _facts(report),
        image,
        section("Robots", _robots(report)),
        section("Windows", _windows(report)),
        section("Points dropped, scans skipped", _losses(report)),
        section("Map", _map(report)),
        section("Layers", _layers(report)),
        section("Seconds of each robot", _seconds(by_robot)),
        section("Seconds of the run", _seconds({"run": report.get("seconds", {})})),
        section("Settings", _settings(report)),
        section("Files", table((), [[name, file] for name, file in report.get("files", {}).items()])),
    ]


def _robots_of(report: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
    return dict(report.get("robots", {}))


def _facts(report: Mapping[str, Any]) -> str:
    """The few numbers that are looked at first."""
    robots = _robots_of(report).values()
    resolution = report.get("map", {}).get("resolution_m")
    cells = report.get("cells")
    facts = {
        "robots": str(len(robots)),
        "scans": _count(sum(robot.get("scans", 0) for robot in robots)),
        "points": _count(sum(robot.get("points", 0) for robot in robots)),
        "points a second": _count(report.get("points_per_second")),
        "cells known": _count(cells),
        "area known": f"{_count(cells * resolution**2)} m²" if cells and resolution else "",
        "sent in deltas": _bytes(sum(report.get("delta_bytes_per_robot", {}).values())),
    }
    return boxes(facts)


def _robots(report: Mapping[str, Any]) -> str:
    head = ["robot", "log", "scans", "points", "points/s", "scans/s", "distance", "deltas", "bytes"]
    delta_bytes = report.get("delta_bytes_per_robot", {})
    rows: list[Row] = [
        [
            name,
            " ".join(str(robot[key]) for key in ("log", "reader", "sensor") if robot.get(key)),
            Number(_count(robot.get("scans"))),
            Number(_count(robot.get("points"))),
            Number(_count(robot.get("points_per_second"))),
            Number(_short(robot.get("scans_per_second"))),
            Number(f"{_short(robot['distance_m'])} m" if "distance_m" in robot else ""),
            Number(_count(robot.get("deltas"))),
            Number(_bytes(delta_bytes.get(name))),
        ]
        for name, robot in _robots_of(report).items()
    ]
    return table(head, rows)


PAGING = {"most_resident": "tiles in memory", "loads": "loads", "writes": "writes", "evictions": "evicted"}


def _windows(report: Mapping[str, Any]) -> str:
    """How much was allocated, how much of it was ever seen, and what the paging cost."""
    head = ["robot", "cells in the window", "observed", "cells allocated", "observed", *PAGING.values()]
    rows: list[Row] = [
        [name, *_allocation(robot.get("allocation", {})), *(Number(_count(robot.get(key))) for key in PAGING)]
        for name, robot in _robots_of(report).items()
    ]
    return table(head, rows)


def _allocation(held: Mapping[str, float]) -> list[Number]:
    cells = {"window_cells": "observed_of_window", "allocated_cells": "observed_of_allocated"}
    return [
        number
        for of, ratio in cells.items()
        for number in (Number(_count(held.get(of))), Number(f"{held[ratio]:.1%}" if ratio in held else ""))
    ]


def _losses(report: Mapping[str, Any]) -> str:
    rows = [
        [name, what, reason, Number(_count(count))]
        for name, robot in _robots_of(report).items()
        for what, key in (("points dropped", "dropped"), ("scans skipped", "skipped"))
        for reason, count in robot.get(key, {}).items()
    ]
    return table(["robot", "what", "reason", "how many"], rows)


def _map(report: Mapping[str, Any]) -> str:
    about = report.get("map", {})
    bounds = about.get("bounds") or report.get("bounds")
    facts = {
        "model": about.get("model"),
        "cell": f"{about['resolution_m']:g} m" if "resolution_m" in about else None,
        "tile": f"{about['tile_m']:g} m" if "tile_m" in about else None,
        "frame": about.get("crs") or "local, metres",
        "west, south, east, north": ", ".join(f"{b:.10g}" for b in bounds) + " m" if bounds else "nothing known",
        "known cells": _count(about.get("cells", report.get("cells"))),
        "tiles": _count(about.get("tiles", report.get("tiles"))),
        "most memory of tiles": _bytes(report.get("allocated_bytes")),
        "most memory of the process": _bytes(report.get("resident_bytes")),
        "SHA-256 of the cells": about.get("digest"),
    }
    return table((), [[name, str(value)] for name, value in facts.items() if value not in (None, "")])


def _layers(report: Mapping[str, Any]) -> str:
    rows = [
        [
            name,
            "UTC" if name == "stamp" else str(layer.get("unit", "")).removesuffix("1"),
            *(Number(_value(name, layer.get(key))) for key in ("min", "mean", "max")),
            Number(_count(layer.get("cells"))),
        ]
        for name, layer in report.get("layers", {}).items()
    ]
    return table(["layer", "unit", "min", "mean", "max", "cells"], rows)


def _seconds(stages: Mapping[str, Mapping[str, float]]) -> str:
    """A line each, a column a stage."""
    names = list(dict.fromkeys(stage for seconds in stages.values() for stage in seconds))
    rows: list[Row] = [
        [who, *(Number(f"{seconds[name]:.3f}" if name in seconds else "") for name in names)]
        for who, seconds in stages.items()
    ]
    return table(["", *names], rows) if names else ""


def _settings(report: Mapping[str, Any]) -> str:
    settings = {**report.get("settings", {}), **report.get("map", {}).get("settings", {})}
    rows = [[name, value if isinstance(value, str) else json.dumps(value)] for name, value in settings.items()]
    return table((), rows)


def _count(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}"


def _short(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:,.1f}" if 1e5 <= abs(value) < 1e12 else f"{value:.5g}"


def _value(layer: str, value: float | None) -> str:
    if layer == "stamp" and value is not None:
        return f"{datetime.fromtimestamp(value, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3]
    return _short(value)


def _bytes(value: float | None) -> str:
    if not value:
        return "" if value is None else "0 B"
    step = min(int(math.log10(value) / 3), 4)
    return f"{value / 1000**step:.3g} {('B', 'KB', 'MB', 'GB', 'TB')[step]}"
