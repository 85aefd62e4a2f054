"""Whether what is known beforehand lies where the map is, and on a part of it that a map can have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.prior.source import Extent, Placed, PriorSource
from terrafuse.types import Bounds, Floats, TileKey

MAX_CELLS = 2 * 10**8
"""Of one feature or raster: 20 by 10 km of 1 m cells."""
MAX_MAP_CELLS = 3 * 10**8
"""Of the rectangle around all: what a GeoTIFF of the map may have."""
DEGREES = Bounds(-180.0, -90.0, 180.0, 90.0)


def check_frame(source: PriorSource, path: Path, lattice: Lattice) -> None:
    """Raise InputError for coordinates that must be degrees, in a map of metres, of a file that doesn't say so."""
    if lattice.crs is None and source.crs is not None:
        raise InputError(
            f"prior map {path}: is in {source.crs[:40]}, and the map in a frame of its own; "
            "say where that lies: --crs EPSG:… --origin EAST,NORTH"
        )
    if lattice.crs is None or source.crs is not None:
        return
    west, south, east, north = source.bounds()
    if west >= DEGREES.west and south >= DEGREES.south and east <= DEGREES.east and north <= DEGREES.north:
        raise InputError(
            f"prior map {path}: lies nowhere near the places of {lattice.crs}: its coordinates, {west:g} to {east:g} "
            f"and {south:g} to {north:g}, look like degrees and it states no CRS; say so by {path.name}?crs=EPSG:4326"
        )


def check_extents(extents: Sequence[Extent], lattice: Lattice, beginnings: Mapping[str, tuple[float, float]]) -> None:
    """Raise InputError for an extent that is too large, or too far from the others or from the robots."""
    for extent in extents:
        i0, j0, i1, j1 = extent.window
        if (i1 - i0) * (j1 - j0) > MAX_CELLS:
            raise InputError(
                f"{_described(extent)} is {(i1 - i0) * (j1 - j0):.2g} cells of {lattice.resolution_m:g} m: at most "
                f"{MAX_CELLS:.0e}; cut out the part around the robots, or use larger cells"
            )
    places = np.array(list(beginnings.values())).reshape(-1, 2)
    cells = _cells_around(extents, np.floor(places * lattice.cells_per_m))
    if cells > MAX_MAP_CELLS:
        far, away_m = _farthest(extents, places)
        raise InputError(
            f"{_described(far)} lies {away_m / 1000:.4g} km from {_names(beginnings)}: the map would be a raster of "
            f"{cells:.2g} cells of {lattice.resolution_m:g} m, at most {MAX_MAP_CELLS:.0e}; "
            "leave it out, or is its CRS another?"
        )


def _names(beginnings: Mapping[str, tuple[float, float]]) -> str:
    if not beginnings:
        return "the rest"
    return f"where {' and '.join(beginnings)} begin{'s' if len(beginnings) == 1 else ''}"


def _cells_around(extents: Sequence[Extent], places: Floats) -> float:
    """Cells of the rectangle around all extents and places (N, 2), in cells."""
    windows = np.array([extent.window for extent in extents], np.float64)
    low = np.concatenate([windows[:, :2], places]).min(axis=0)
    high = np.concatenate([windows[:, 2:], places + 1]).max(axis=0)
    return float(np.prod(high - low))


def _farthest(extents: Sequence[Extent], places: Floats) -> tuple[Extent, float]:
    """(the extent, metres) that lies furthest from the middle of the places, or from that of all extents."""
    bounds = np.array([extent.bounds for extent in extents])
    centres = (bounds[:, :2] + bounds[:, 2:]) / 2
    away_m = np.hypot(*(centres - np.median(places if len(places) else centres, axis=0)).T)
    return extents[int(away_m.argmax())], float(away_m.max())


def _described(extent: Extent) -> str:
    west, south, east, north = extent.bounds
    return f"{extent.what}, {west:.10g} to {east:.10g} east and {south:.10g} to {north:.10g} north,"


def tiles(placed: Placed, lattice: Lattice) -> list[TileKey]:
    """Those that may get cells, line by line."""
    side = lattice.tile_cells
    found = {
        (y, x)
        for i0, j0, i1, j1 in (extent.window for extent in placed.extents())
        if i0 < i1 and j0 < j1
        for y in range(j0 // side, (j1 - 1) // side + 1)
        for x in range(i0 // side, (i1 - 1) // side + 1)
    }
    return [TileKey(x, y) for y, x in sorted(found)]
