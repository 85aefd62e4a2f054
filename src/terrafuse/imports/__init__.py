"""Maps from elsewhere as one robot's contribution. An importer is one object in the dict `IMPORTERS`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from terrafuse.errors import InputError, OutputError
from terrafuse.export.files import final
from terrafuse.imports.base import Contribution, Importer, Wishes
from terrafuse.imports.raster import take_raster
from terrafuse.imports.ros import take_ros_map
from terrafuse.store.sqlite import SqliteStore, remove_store

IMPORTERS: dict[str, Importer] = {
    "ros-map": Importer((".yaml", ".yml"), "ROS map_server YAML with its image → occupancy", take_ros_map),
    "raster": Importer((".tif", ".tiff", ".hgt", ".asc", ".img", ".vrt"), "raster of heights → elevation", take_raster),
}


def importer_of(file: Path) -> str:
    """The importer whose ending the file has. Raises InputError if none has it."""
    for name, importer in IMPORTERS.items():
        if file.suffix.lower() in importer.suffixes:
            return name
    if file.suffix.lower() in (".pgm", ".png", ".bmp"):
        raise InputError(f"{file}: give the .yaml of the ROS map, which names its image and says where it lies")
    known = ", ".join(f"{name} ({', '.join(importer.suffixes)})" for name, importer in IMPORTERS.items())
    raise InputError(f"{file}: no importer takes '{file.suffix}'; there are: {known}")


def import_map(
    file: Path | str, out: Path | str, wishes: Wishes | None = None, overwrite: bool = False
) -> dict[str, Any]:
    """Make a store of a file; returns what was done, as plain JSON.

    The store appears under its name when it is whole. Raises InputError for a file that can't be taken in, OutputError
    where `out` exists (unless `overwrite`) or can't be written.
    """
    source, target, wishes = Path(file), Path(out), wishes or Wishes()
    name = importer_of(source)
    if not source.is_file():
        raise InputError(f"{source}: no such file")
    if target.exists() and target.samefile(source):
        raise InputError(f"{target}: that is the file itself; choose another --out")
    if target.exists() and not overwrite:
        raise OutputError(f"{target}: exists already; choose another --out, or replace it with --overwrite")
    taken = IMPORTERS[name].take(source, wishes)
    with final(target) as temporary:
        temporary.unlink()
        cells = _fill(temporary, taken)
        if cells == 0:
            raise InputError(f"{source}: no cell of it is known; there is nothing to import")
        remove_store(target)
    return {
        "out": str(target),
        "format": name,
        "robot": wishes.robot,
        "model": taken.model.name,
        "resolution_m": taken.lattice.resolution_m,
        "tile_m": taken.lattice.tile_m,
        "crs": taken.lattice.crs,
        "cells": cells,
        "remarks": list(taken.remarks),
    }


def _fill(path: Path, taken: Contribution) -> int:
    """A finished store of the contribution; returns how many cells it has."""
    cells = 0
    with SqliteStore.create(path, taken.lattice, taken.model, taken.notes) as store:
        for delta in taken.deltas:
            store.accept(delta)
            cells += delta.cell_count
        store.finish()
    return cells


__all__ = ["IMPORTERS", "Contribution", "Importer", "Wishes", "import_map", "importer_of"]
