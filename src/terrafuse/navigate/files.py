"""A path as a file: a picture of it on the map, or a line for GIS programs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

from terrafuse import views
from terrafuse.errors import InputError
from terrafuse.export import sheet
from terrafuse.export.files import final
from terrafuse.export.looks import LOOKS
from terrafuse.export.picture import Subject, draw_subject
from terrafuse.navigate.path import Path
from terrafuse.replica import Replica
from terrafuse.types import Bounds


def write_picture(path: Path, replica: Replica, file: File, bounds: Bounds | None) -> None:
    """The path over how surely each cell is in a robot's way. Raises OutputError."""
    title = f"{path.length_m:.1f} m, as dear as {path.cost_m:.1f} m of free ground"
    draw_subject(file, lambda: _subject(replica, bounds), {"path": path.waypoints_m}, title)


def _subject(replica: Replica, bounds: Bounds | None) -> Subject:
    layer, window = replica.model.occupied, views.window_of(replica, bounds)
    factor = math.ceil(max(views.shape_of(window)) / sheet.MOST_PIXELS)
    image = views.reduced(replica, layer, window, factor)
    west, south = views.bounds_of(replica, window)[:2]
    return Subject(layer, replica.lattice, factor, image, west, south, LOOKS["occupancy"])


def write_geojson(path: Path, replica: Replica, file: File, bounds: Bounds | None) -> None:
    """A FeatureCollection with one LineString of the waypoints, in the map's frame, which GeoJSON 2008's `crs` names.

    A map in a local frame has none: GIS programs then take its metres for degrees, unless they are told.
    """
    content: dict[str, Any] = {"type": "FeatureCollection"}
    if replica.lattice.crs is not None:
        content["crs"] = {"type": "name", "properties": {"name": replica.lattice.crs}}
    line = {"type": "LineString", "coordinates": _line(path)}
    facts = {"length_m": path.length_m, "cost_m": path.cost_m, "unknown_m": path.unknown_m}
    content["features"] = [{"type": "Feature", "geometry": line, "properties": facts}]
    with final(file) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _line(path: Path) -> list[list[float]]:
    """A LineString has two points at least."""
    points: list[list[float]] = path.waypoints_m.round(6).tolist()
    return points if len(points) > 1 else points * 2


Write = Callable[[Path, Replica, File, Bounds | None], None]

WRITERS: dict[str, Write] = {".png": write_picture, ".geojson": write_geojson, ".json": write_geojson}


def writer_of(file: File) -> Write:
    """What writes files with this ending. Raises InputError."""
    if file.suffix.lower() not in WRITERS:
        raise InputError(f"{file}: a path becomes a file that ends in {', '.join(WRITERS)}")
    return WRITERS[file.suffix.lower()]
