"""The map as ROS map_server reads it: map.yaml and an image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import views
from terrafuse.errors import InputError
from terrafuse.export.files import final
from terrafuse.models.base import Layer
from terrafuse.replica import Replica
from terrafuse.rosmap.files import image_line, image_suffix, write_map
from terrafuse.rosmap.meaning import Meaning, percent, pixels
from terrafuse.rosmap.memory import NOTE, recall
from terrafuse.rosmap.types import Placement, RosMap
from terrafuse.types import Bounds, Floats

OPTIONS = ("mode", "occupied_thresh", "free_thresh", "negate")
FULL_SCALE = {"occupied_thresh": 1.0, "free_thresh": 0.0}
"""Thresholds of scale mode unless others are wished: all 256 greys between 0 and 1."""


@dataclass(frozen=True, eq=False)
class Imported:
    """The ROS map that a map began as, and the cells that it covers."""

    ros_map: RosMap
    window: views.CellWindow


def write_ros_map(
    replica: Replica,
    path: Path | str,
    layers: Sequence[str] | None = None,
    bounds: Bounds | None = None,
    **options: Any,
) -> None:
    """Write `path` (the YAML) and an image beside it, .pgm, or .png where scale mode has unknown cells to show.

    The values are those of the model's `occupied`, or of one layer of values 0 to 1. `options`: mode, occupied_thresh,
    free_thresh, negate; what is not given is as in the ROS map that this map was imported from, else map_saver's. A
    pixel of that map which still says what its cell says stays as it was. Raises InputError for an empty map, a layer
    of other values, options that no map has.
    """
    target = Path(path)
    layer = _layer(replica, layers)
    imported = imported_map(replica)
    meaning = _meaning(imported, options)
    window = _window(replica, imported, bounds)
    values = views.mosaic(replica, [layer], window)[layer.name][::-1]
    _check_values(layer, values)
    ros_map = RosMap(_placement(replica, window, imported), meaning, *pixels(values, meaning))
    if imported is not None and imported.ros_map.meaning == meaning:
        ros_map = _as_before(ros_map, values, window, imported)
    image = target.with_suffix(image_suffix(ros_map))
    if image == target:
        raise InputError(f"{target}: that is the image's name; give --out a .yaml")
    _check_image(image, target)
    with final(target) as yaml_file, final(image) as image_file:
        write_map(ros_map, yaml_file, image_file, image.name)


def _check_image(image: Path, target: Path) -> None:
    """Raise InputError where the image would replace a file that is not the image of the map that is replaced."""
    if image.exists():
        former = target.read_text(errors="replace") if target.is_file() else ""
        if image_line(image.name) not in former:
            raise InputError(f"{image}: is there already, and belongs to no such map; choose another --out")


def _layer(replica: Replica, names: Sequence[str] | None) -> Layer:
    if not names:
        return replica.model.occupied
    if len(names) > 1:
        raise InputError(f"a ROS map shows one layer, not {', '.join(names)}; write a map of each")
    return views.chosen_layers(replica, names)[0]


def imported_map(replica: Replica) -> Imported | None:
    """The ROS map that the store remembers, if the robot that it came as is part of this map."""
    notes: Mapping[str, Any] = getattr(replica.store, "notes", dict)()  # a store in memory has none
    if NOTE not in notes or notes[NOTE]["robot"] not in replica.robots:
        return None
    if replica.lattice.resolution_m != replica.store.map.resolution_m:
        return None  # a coarser level
    ros_map = recall(notes[NOTE])
    i0, j0 = notes[NOTE]["cell"]
    rows, columns = ros_map.grey.shape
    return Imported(ros_map, (i0, j0, i0 + columns, j0 + rows))


def _meaning(imported: Imported | None, options: dict[str, Any]) -> Meaning:
    wished = {name: value for name, value in options.items() if value is not None}
    mode = wished.get("mode")
    if imported is not None and mode in (None, imported.ros_map.meaning.mode):
        return replace(imported.ros_map.meaning, **wished)
    return Meaning(**((FULL_SCALE if mode == "scale" else {}) | wished))


def _window(replica: Replica, imported: Imported | None, bounds: Bounds | None) -> views.CellWindow:
    if bounds is not None or imported is None:
        return views.window_of(replica, bounds)
    known = views.known_window(replica) or imported.window
    i0, j0, i1, j1 = imported.window
    return min(i0, known[0]), min(j0, known[1]), max(i1, known[2]), max(j1, known[3])


def _placement(replica: Replica, window: views.CellWindow, imported: Imported | None) -> Placement:
    if imported is not None and imported.window == window:
        return imported.ros_map.placement
    west, south = views.bounds_of(replica, window)[:2]
    return Placement(replica.lattice.resolution_m, west, south)


def _check_values(layer: Layer, values: Floats) -> None:
    low, high = np.nanmin(values, initial=1.0), np.nanmax(values, initial=0.0)
    if not (0.0 <= low and high <= 1.0):
        raise InputError(
            f"layer '{layer.name}' ({layer.unit}) has values from {low:g} to {high:g}; a ROS map takes one of 0 (free) "
            "to 1 (occupied): leave --layer out for the model's own"
        )


def _as_before(ros_map: RosMap, values: Floats, window: views.CellWindow, imported: Imported) -> RosMap:
    """With the imported pixels wherever they mean what the cells say, in whole percent."""
    before = imported.ros_map
    i0, j0, i1, j1 = window
    a, b, c, d = imported.window
    left, right, low, high = max(a, i0), min(c, i1), max(b, j0), min(d, j1)
    if left >= right or low >= high:
        return ros_map
    here = slice(j1 - high, j1 - low), slice(left - i0, right - i0)
    there = slice(d - high, d - low), slice(left - a, right - a)
    same = percent(values[here]) == percent(before.probability[there])
    grey = ros_map.grey.copy()
    grey[here] = np.where(same, before.grey[there], grey[here])
    opaque = np.ones(grey.shape, bool) if ros_map.opaque is None else ros_map.opaque.copy()
    if before.opaque is not None:
        opaque[here] = np.where(same, before.opaque[there], opaque[here])
    else:
        opaque[here] |= same
    return replace(ros_map, grey=grey, opaque=None if opaque.all() else opaque)
