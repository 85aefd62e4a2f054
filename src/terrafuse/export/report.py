"""A mapping run as one HTML file that needs nothing else: no scripts, no links, the picture inside."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any

from terrafuse.errors import InputError
from terrafuse.export.files import final

STYLE = """
:root { color-scheme: light dark; --ink: #22272e; --quiet: #68717d; --line: #dfe3e8; --page: #ffffff; --soft: #f6f7f9;
  --accent: #2f6650; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ed; --quiet: #98a2ae; --line: #343b44; --page: #15191e;
  --soft: #1d2229; --accent: #86c5a5; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 2rem 1.25rem 4rem; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0; }
h2 { font-size: 1.1rem; margin: 2.2rem 0 .6rem; color: var(--accent); }
.quiet { color: var(--quiet); margin: .2rem 0 1.2rem; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.5rem, 1fr)); gap: .75rem; margin: 1.2rem 0; }
.facts div { background: var(--soft); border: 1px solid var(--line); border-radius: .5rem; padding: .6rem .8rem; }
.facts b { display: block; font-size: 1.3rem; font-weight: 600; font-variant-numeric: tabular-nums; }
.facts span { color: var(--quiet); font-size: .8rem; }
img { display: block; max-width: 100%; height: auto; margin: auto; }
figure { margin: 0; background: #ffffff; border: 1px solid var(--line); border-radius: .5rem; padding: .5rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; }
th, td { padding: .35rem .7rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
thead th { color: var(--quiet); font-weight: 500; white-space: nowrap; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td { min-width: 7rem; overflow-wrap: anywhere; }
td.number { min-width: 0; }
th[scope=row] { font-weight: 600; white-space: nowrap; }
code { font: .85em ui-monospace, "DejaVu Sans Mono", monospace; }
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>{title}</h1>
<p class="quiet">{about}</p>
{body}
</body>
</html>
"""

Row = Sequence["str | Number"]


@dataclass(frozen=True)
class Number:
    """A cell that is set to the right."""

    text: str


def write_report(path: Path | str, report: Mapping[str, Any], picture: Path | str) -> None:
    """Write the report (see `terrafuse.results.report_of`; keys that are missing are left out) with the PNG `picture`.

    Raises InputError if the picture can't be read, OutputError where the file can't be written.
    """
    try:
        image = base64.b64encode(Path(picture).read_bytes()).decode("ascii")
    except OSError as error:
        raise InputError(f"{picture}: the report's picture can't be read: {error.strerror}") from error
    robots = " + ".join(_robots_of(report))
    text = PAGE.format(
        title=escape(f"Map of {robots}" if robots else "Map"),
        style=STYLE,
        about=escape(f"terrafuse {report.get('terrafuse', '')}"),
        body=_body(report, image),
    )
    with final(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _body(report: Mapping[str, Any], image: str) -> str:
    by_robot = {name: robot.get("seconds", {}) for name, robot in _robots_of(report).items()}
    return "\n".join(
        [
            _facts(report),
            f'<figure><img alt="The map, seen from above" src="data:image/png;base64,{image}"/></figure>',
            _section("Robots", _robots(report)),
            _section("Windows", _windows(report)),
            _section("Points dropped, scans skipped", _losses(report)),
            _section("Map", _map(report)),
            _section("Layers", _layers(report)),
            _section("Seconds of each robot", _seconds(by_robot)),
            _section("Seconds of the run", _seconds({"run": report.get("seconds", {})})),
            _section("Settings", _settings(report)),
            _section("Files", _table((), [[name, file] for name, file in report.get("files", {}).items()])),
        ]
    )


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
    boxes = (f"<div><b>{escape(value)}</b><span>{name}</span></div>" for name, value in facts.items() if value)
    return f'<div class="facts">{"".join(boxes)}</div>'


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
    return _table(head, rows)


PAGING = {"most_resident": "tiles in memory", "loads": "loads", "writes": "writes", "evictions": "evicted"}


def _windows(report: Mapping[str, Any]) -> str:
    """How much was allocated, how much of it was ever seen, and what the paging cost."""
    head = ["robot", "cells in the window", "observed", "cells allocated", "observed", *PAGING.values()]
    rows: list[Row] = [
        [name, *_allocation(robot.get("allocation", {})), *(Number(_count(robot.get(key))) for key in PAGING)]
        for name, robot in _robots_of(report).items()
    ]
    return _table(head, rows)


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
    return _table(["robot", "what", "reason", "how many"], rows)


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
    return _table((), [[name, str(value)] for name, value in facts.items() if value not in (None, "")])


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
    return _table(["layer", "unit", "min", "mean", "max", "cells"], rows)


def _seconds(stages: Mapping[str, Mapping[str, float]]) -> str:
    """A line each, a column a stage."""
    names = list(dict.fromkeys(stage for seconds in stages.values() for stage in seconds))
    rows: list[Row] = [
        [who, *(Number(f"{seconds[name]:.3f}" if name in seconds else "") for name in names)]
        for who, seconds in stages.items()
    ]
    return _table(["", *names], rows) if names else ""


def _settings(report: Mapping[str, Any]) -> str:
    settings = {**report.get("settings", {}), **report.get("map", {}).get("settings", {})}
    rows = [[name, value if isinstance(value, str) else json.dumps(value)] for name, value in settings.items()]
    return _table((), rows)


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>{content}</section>" if content else ""


def _table(head: Iterable[str], rows: Sequence[Row]) -> str:
    """Empty without rows. The first cell of a row names it; everything is escaped here."""
    if not rows:
        return ""
    kinds = [' class="number"' if isinstance(cell, Number) else "" for cell in rows[0]]
    titles = "".join(f"<th{kind}>{escape(name)}</th>" for name, kind in zip(head, kinds, strict=False))
    lines = "".join(f"<tr>{_cells(row)}</tr>" for row in rows)
    header = f"<thead><tr>{titles}</tr></thead>" if titles else ""
    return f'<div class="wide"><table>{header}<tbody>{lines}</tbody></table></div>'


def _cells(row: Row) -> str:
    first, *others = row
    cells = [f'<th scope="row">{escape(str(first))}</th>']
    for cell in others:
        if isinstance(cell, Number):
            cells.append(f'<td class="number">{escape(cell.text)}</td>')
        else:
            cells.append(f"<td>{escape(cell)}</td>")
    return "".join(cells)


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
