"""The map as files for other tools. An exporter is one object in the dict `EXPORTERS`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from terrafuse import views
from terrafuse.errors import InputError
from terrafuse.export.cog import write_cog
from terrafuse.export.npz import write_npz
from terrafuse.export.picture import robot_paths, write_picture
from terrafuse.export.ros_map import OPTIONS, write_ros_map
from terrafuse.replica import Replica
from terrafuse.types import Bounds

Write = Callable[..., None]


@dataclass(frozen=True)
class Exporter:
    """One file format. `write` takes the replica, the path, the layers and the bounds, None meaning all; and the
    `options` of the format by their names, where they are given."""

    suffixes: tuple[str, ...]
    summary: str
    write: Write
    options: tuple[str, ...] = ()


def _picture(replica: Replica, path: Path, layers: Sequence[str] | None, bounds: Bounds | None) -> None:
    if layers and len(layers) > 1:
        raise InputError(f"a picture shows one layer, not {', '.join(layers)}; write a picture of each")
    write_picture(replica, path, layers[0] if layers else None, bounds, robot_paths(replica))


EXPORTERS: dict[str, Exporter] = {
    "cog": Exporter((".tif", ".tiff"), "Cloud Optimized GeoTIFF, a band a layer, for GIS tools", write_cog),
    "png": Exporter((".png",), "picture of one layer with the robots' paths", _picture),
    "npz": Exporter((".npz",), "NumPy arrays with their coordinates", write_npz),
    "ros-map": Exporter((".yaml", ".yml"), "ROS map_server YAML with its image beside it", write_ros_map, OPTIONS),
}


def export_map(
    replica: Replica,
    out: Path | str,
    format: str | None = None,
    layers: Sequence[str] | None = None,
    bounds: Bounds | None = None,
    **options: Any,
) -> str:
    """Write the map to a file in a format of EXPORTERS, by default the one that the ending says; returns its name.

    `options` are the format's own; None leaves one out. Raises InputError for a format, an ending or an option that
    there is not, OutputError where the file can't be written.
    """
    path = Path(out)
    name = format or format_of(path)
    if name not in EXPORTERS:
        raise InputError(f"no format '{name}'; there are: {known_formats()}")
    given = {option: value for option, value in options.items() if value is not None}
    if unknown := given.keys() - set(EXPORTERS[name].options):
        raise InputError(f"the format '{name}' has no option {', '.join(sorted(unknown))}")
    if bounds is not None:
        _check_bounds(replica, bounds)
    EXPORTERS[name].write(replica, path, layers, bounds, **given)
    return name


def _check_bounds(replica: Replica, bounds: Bounds) -> None:
    """Raise InputError where no tile of the map meets the bounds: an empty file would look like an empty map."""
    if not views.keys_in(replica, replica.lattice.cell_window(bounds)):
        window = views.known_window(replica)
        whole = tuple(views.bounds_of(replica, window)) if window else "empty"
        raise InputError(f"nothing of the map lies within {tuple(bounds)}; the map is {whole}")


def format_of(path: Path) -> str:
    """The format whose ending the path has. Raises InputError if none has it."""
    for name, exporter in EXPORTERS.items():
        if path.suffix.lower() in exporter.suffixes:
            return name
    raise InputError(f"{path}: no format has the ending '{path.suffix}'; there are: {known_formats()}")


def known_formats() -> str:
    return ", ".join(f"{name} ({', '.join(exporter.suffixes)})" for name, exporter in EXPORTERS.items())


__all__ = ["EXPORTERS", "Exporter", "export_map", "format_of", "known_formats"]
