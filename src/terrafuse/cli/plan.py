"""`terrafuse plan`: a path over the map."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from terrafuse.cli import arguments
from terrafuse.cli.commands import Json, StoreFile
from terrafuse.cli.output import say, say_json, tell_of_compiling
from terrafuse.cli.plugins import Plugins

if TYPE_CHECKING:
    from terrafuse.navigate import Path as RobotsPath
    from terrafuse.types import Floats

MOST_SHOWN = 12
"""Waypoints in the text: more are for machines."""


def plan_(
    store: StoreFile,
    start: Annotated[str, typer.Option("--from", metavar="E,N", help="Where it starts: east and north, metres.")],
    goal: Annotated[str, typer.Option("--to", metavar="E,N", help="Where it leads.")],
    robot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The robot, as YAML: radius_m, unknown, …  [default: a radius of 0.25 m]"),
    ] = None,
    bounds: Annotated[
        str | None,
        typer.Option(metavar="W,S,E,N", help="Part of the map to stay in, metres.  [default: what is known]"),
    ] = None,
    any_angle: Annotated[
        bool, typer.Option("--any-angle", help="Straight lines where they cost no more, not only eight directions.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write it: a .png on the map, or a .geojson for GIS programs.")
    ] = None,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Find the cheapest way for a robot over the map; ends with code 1 and the reason where there is none.

    Obstacles are cells that are surely occupied; the path keeps the robot's radius from them. See docs/planning.md.
    """
    from terrafuse.errors import InputError
    from terrafuse.navigate import Robot, load_robot, plan_path
    from terrafuse.navigate.files import writer_of
    from terrafuse.replica import Replica
    from terrafuse.store.sqlite import SqliteStore

    tell_of_compiling()
    arguments.store_file(store)
    if out is not None and out.exists() and store.exists() and out.samefile(store):
        raise InputError(f"{out}: that is the store itself; choose another --out")
    ends, part = [_place("--from", start), _place("--to", goal)], arguments.bounds(bounds)
    write = None if out is None else writer_of(out)
    described = Robot() if robot is None else load_robot(robot)
    with SqliteStore.open(store) as opened:
        replica = Replica(store=opened)
        path = plan_path(replica, ends[0], ends[1], described, part, any_angle)
        if write is not None and out is not None:
            write(path, replica, out, part)
    if json:
        say_json(_facts(path) | ({} if out is None else {"out": str(out)}))
    else:
        _tell(path, out)


def _place(option: str, text: str) -> tuple[float, float]:
    east, north = arguments.numbers(option, text, "EAST,NORTH") or ()
    return east, north


def main_corners(line: Floats, most: int) -> Floats:
    """At most so many of a line's points (K, 2), in order: its ends, and each time the point that lies furthest from
    the line through those before (Douglas & Peucker, by number instead of by distance)."""
    import numpy as np

    kept = [0, len(line) - 1]
    while len(kept) < min(most, len(line)):
        aside = [_aside(line[first : last + 1]) for first, last in pairwise(kept)]
        k = int(np.argmax([float(distances.max(initial=0.0)) for distances in aside]))
        furthest = kept[k] + int(np.argmax(aside[k]))
        if furthest in kept:
            break
        kept = sorted({*kept, furthest})
    return line[sorted(set(kept))]


def _aside(part: Floats) -> Floats:
    """How far points (K, 2) lie from the segment between the first and the last."""
    import numpy as np

    along = part[-1] - part[0]
    offsets = part - part[0]
    share = np.clip(offsets @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(offsets - share[:, None] * along, axis=1))


def _facts(path: RobotsPath) -> dict[str, Any]:
    return {
        "length_m": path.length_m,
        "cost_m": path.cost_m,
        "unknown_m": path.unknown_m,
        "expanded": path.expanded,
        "waypoints_m": path.waypoints_m.round(6).tolist(),
    }


def _tell(path: RobotsPath, out: Path | None) -> None:
    say(f"length {path.length_m:.2f} m, of which {path.unknown_m:.2f} m through the unknown")
    say(f"cost {path.cost_m:.2f}: as much as so many metres of free ground")
    corners = main_corners(path.waypoints_m, MOST_SHOWN)
    count = len(path.waypoints_m)
    said = "" if len(corners) == count else f", {len(corners)} of them here, all with --json or --out way.geojson"
    say(f"{count} waypoints (east, north){said}; {path.expanded:,} cells looked at")
    for east, north in corners.round(6).tolist():
        say(f"  {east:.12g},{north:.12g}")
    if out is not None:
        say(f"wrote {out}")
