"""What can be compared: a store, a raster, a ROS map, each as an array with the grid that it lies on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from terrafuse import views
from terrafuse.errors import InputError
from terrafuse.grids import Grid, window_grid
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer, Model
from terrafuse.raster import HEIGHT_BANDS, band_names, read_raster
from terrafuse.replica import Replica
from terrafuse.rosmap import read_map
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Floats

VALUES, OCCUPANCY = "values", "occupancy"
STORE, RASTER, ROS_MAP = "store", "raster", "ROS map"
OCCUPIED_BANDS = ("occupancy", "white")
"""Names of bands that say how surely cells are occupied: of an `occupancy` and of a `grey` map's GeoTIFF."""


@dataclass(frozen=True, eq=False)
class Field:
    """`values` (H, W), NaN unknown, on a grid; `name` is the file's, `quantity` the layer's or band's; `what` says all
    of it in words."""

    values: Floats
    grid: Grid
    unit: str
    name: str
    quantity: str
    what: str


@dataclass(frozen=True)
class Source:
    """Something that can be compared. `natural` is the kind of comparison that suits it, None where any does;
    `field(kind, layer, band)` reads it for one."""

    what: str
    natural: str | None
    field: Callable[[str, str | None, str | None], Field]
    names: tuple[str, ...] = ()
    """Of a raster: its bands."""

    @property
    def only_occupancy(self) -> bool:
        """Whether it has no other values."""
        return self.what == ROS_MAP


def open_source(path: Path) -> Source:
    """By what the file is. Raises InputError for one that is missing or neither of the three."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the store in it (map.db), a raster or the .yaml of a ROS map")
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a store, a raster (GeoTIFF) or the .yaml of a ROS map")
    if path.suffix.lower() in (".yaml", ".yml"):
        return Source(ROS_MAP, OCCUPANCY, lambda kind, layer, band: _ros_field(path))
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"SQLite format 3"):
        with SqliteStore.open(path) as store:
            natural = _natural(store.model)
        return Source(STORE, natural, lambda kind, layer, band: _store_field(path, kind, layer))
    names = tuple(band_names(path))
    occupied = None if set(HEIGHT_BANDS) & set(names) else next((n for n in OCCUPIED_BANDS if n in names), None)
    return Source(
        RASTER,
        OCCUPANCY if occupied else None,
        lambda kind, layer, band: _raster_field(path, layer, band, occupied),
        names,
    )


def _natural(model: Model) -> str:
    """Models that show heights are compared by heights, the others by what is occupied."""
    return VALUES if model.layers[model.picture_layer].unit == "m" else OCCUPANCY


def _ros_field(path: Path) -> Field:
    ros_map = read_map(path)
    about = f"ROS map ({ros_map.meaning.mode}), {_sides(ros_map.grid)}"
    return Field(ros_map.probability, ros_map.grid, "1", path.name, "occupancy", about)


def _raster_field(path: Path, layer: str | None, band: str | None, usual: str | None) -> Field:
    """`usual`: the band where neither is asked for, None for that of heights."""
    try:
        raster = read_raster(path, band or layer or usual)
    except InputError:
        if band is not None or layer is None:
            raise
        raster = read_raster(path, usual)  # a truth raster need not call its band as we call our layer
    return Field(
        raster.values,
        raster.grid,
        raster.unit,
        path.name,
        raster.band,
        f"{raster.band} of a raster, {_sides(raster.grid)}",
    )


def _store_field(path: Path, kind: str, name: str | None) -> Field:
    with SqliteStore.open(path) as store:
        replica = Replica(store=store)
        layer = _layer(replica, kind, name)
        window = views.window_of(replica, None)
        values = views.mosaic(replica, [layer], window)[layer.name][::-1]
        about = f"{layer.name} of {replica.model.name}, {_cells(replica.lattice)}, of {', '.join(replica.robots)}"
    return Field(values, window_grid(replica.lattice, window), layer.unit, path.name, layer.name, about)


def _layer(replica: Replica, kind: str, name: str | None) -> Layer:
    if name is not None:
        return views.chosen_layers(replica, [name])[0]
    model = replica.model
    return model.occupied if kind == OCCUPANCY else views.chosen_layers(replica, [model.picture_layer])[0]


def _sides(grid: Grid) -> str:
    wide, high = (f"{side:.6g}" for side in grid.sides_m)
    frame = "" if grid.crs is None else f" in {grid.crs if len(grid.crs) < 40 else 'a CRS of its own'}"
    return f"pixels of {wide}" + ("" if wide == high else f" × {high}") + frame


def _cells(lattice: Lattice) -> str:
    frame = "local frame" if lattice.crs is None else lattice.crs if len(lattice.crs) < 40 else "a CRS of its own"
    return f"cells of {lattice.resolution_m:g} m, {frame}"
