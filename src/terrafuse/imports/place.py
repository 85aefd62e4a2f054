"""Where a raster from elsewhere lies on a lattice."""

from __future__ import annotations

import math

import numpy as np

from terrafuse.errors import InputError
from terrafuse.grids import Grid, bounds_in, covered, transformed, window_grid
from terrafuse.lattice import MAX_CELL, MAX_TILE_CELLS, Lattice, default_tile_m
from terrafuse.types import Array

TOLERANCE_CELLS = 1e-6
"""How far a raster may lie off the lattice: the rounding of coordinates, not a shift that anybody could measure."""

MAX_CELLS = 10**8
"""To resample to; some 5 GB of coordinates on the way."""


def plain(resolution_m: float) -> float:
    """The resolution as it was meant: ROS keeps it in 32 bits, so that 0.05 comes as 0.05000000074505806."""
    short = np.float32(resolution_m)
    return float(str(short)) if float(short) == resolution_m else resolution_m


def lattice_for(resolution_m: float, tile_m: float | None = None, crs: str | None = None) -> Lattice:
    """A lattice of these cells; its tiles are as near to the usual size as a number of cells that ends in 0 comes."""
    if tile_m is not None or not (math.isfinite(resolution_m) and resolution_m > 0):
        return Lattice(resolution_m, tile_m or 1.0, crs)
    usual_m = default_tile_m(resolution_m)
    exact = usual_m / resolution_m
    if not math.isfinite(exact):
        return Lattice(resolution_m, usual_m, crs)  # which says why there is none
    if exact <= MAX_TILE_CELLS and abs(exact - round(exact)) <= TOLERANCE_CELLS:
        return Lattice(resolution_m, usual_m, crs)
    cells = min(10 * round(exact / 10), MAX_TILE_CELLS // 10 * 10)
    return Lattice(resolution_m, round(cells * resolution_m, 9), crs)


def first_cell(east_m: float, north_m: float, lattice: Lattice, remedy: str) -> tuple[int, int]:
    """(i, j) of the cell whose south-western corner this is. Raises InputError where it is no corner of a cell."""
    exact = [coordinate * lattice.cells_per_m for coordinate in (east_m, north_m)]
    if not all(abs(value) <= MAX_CELL for value in exact):
        raise InputError(f"origin {east_m:.10g}, {north_m:.10g} lies beyond the lattice; is it in metres?")
    whole = [round(value) for value in exact]
    off_m = max(abs(value - near) for value, near in zip(exact, whole, strict=True)) * lattice.resolution_m
    if off_m > TOLERANCE_CELLS * lattice.resolution_m:
        raise InputError(
            f"origin {east_m:.10g}, {north_m:.10g} is no multiple of the resolution {lattice.resolution_m:g} m: cells "
            f"count from the world's origin, and this map lies {off_m:.3g} m beside them; {remedy}"
        )
    return whole[0], whole[1]


def nearest(grid: Grid, lattice: Lattice) -> tuple[tuple[int, int, int, int], Array, Array, Array]:
    """(window, row, column, inside): the cells whose centres may lie in a grid, and for each, [row 0 north], the
    element that its centre lies in."""
    window = covered(bounds_in(grid, lattice.crs), lattice)
    if window[0] >= window[2] or window[1] >= window[3]:
        raise InputError(f"no centre of a cell of {lattice.resolution_m:g} m lies in it; use smaller cells")
    cells = window_grid(lattice, window)
    if cells.rows * cells.columns > MAX_CELLS:
        raise InputError(
            f"{cells.columns}×{cells.rows} cells of {lattice.resolution_m:g} m are too many; use larger ones"
        )
    x, y = transformed(*cells.centres(0, cells.rows), lattice.crs, grid.crs)
    return window, *grid.locate(x, y)
