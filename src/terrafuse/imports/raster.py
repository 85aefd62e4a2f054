"""A raster of heights as a contribution to an `elevation` map: one point a cell, at its centre."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from terrafuse import crs
from terrafuse.errors import InputError
from terrafuse.exchange.delta import Delta
from terrafuse.imports.base import Contribution, Wishes
from terrafuse.imports.place import TOLERANCE_CELLS, first_cell, lattice_for, nearest
from terrafuse.kernels.evidence import MAX_Z_M
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.raster import Raster, read_raster
from terrafuse.types import Floats, Pose, Scan

REMEDY = "use --resample, and each cell takes the nearest pixel"


def take_raster(file: Path, wishes: Wishes) -> Contribution:
    """Every valid pixel becomes a cell. Raises InputError where the raster lies on no lattice or holds no heights."""
    raster = read_raster(file, wishes.band, wishes.nodata)
    try:
        lattice = _lattice(raster, wishes)
        first, heights, remarks = _on_lattice(raster, lattice, wishes.resample)
        _check_heights(heights)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    model = make_model("elevation")
    used = f"took {raster.band} as heights in metres"
    return Contribution(lattice, model, _deltas(heights, first, lattice, model, wishes), {}, (used, *remarks))


def _lattice(raster: Raster, wishes: Wishes) -> Lattice:
    stated = wishes.crs or raster.grid.crs
    frame = None if stated is None else crs.canonical(stated)
    resolution_m = wishes.resolution_m or _resolution(raster, frame)
    return lattice_for(resolution_m, wishes.tile_m, frame)


def _resolution(raster: Raster, frame: str | None) -> float:
    if frame != raster.grid.crs and raster.grid.crs is not None:
        raise InputError(f"is in {_short(raster.grid.crs)}; to bring it to {frame}, give --resolution and --resample")
    return raster.grid.sides_m[0]


def _on_lattice(raster: Raster, lattice: Lattice, resample: bool) -> tuple[tuple[int, int], Floats, tuple[str, ...]]:
    """((i, j) of the south-western pixel, heights with row 0 in the south, what was done)."""
    try:
        return _first(raster, lattice), raster.values[::-1], ()
    except InputError:
        if not resample:
            raise
    window, row, column, inside = nearest(raster.grid, lattice)
    heights = np.where(inside, raster.values[row, column], np.nan)[::-1]
    return window[:2], heights, (f"resampled to cells of {lattice.resolution_m:g} m by nearest neighbours",)


def _first(raster: Raster, lattice: Lattice) -> tuple[int, int]:
    grid = raster.grid
    if grid.crs is not None and grid.crs != lattice.crs:
        raise InputError(f"is in {_short(grid.crs)}, not in {_short(lattice.crs)}; {REMEDY}")
    if not grid.straight:
        raise InputError(f"its rows do not run east or its columns not south (transform {grid.affine}); {REMEDY}")
    wide, high = grid.sides_m
    if not all(
        math.isclose(side, lattice.resolution_m, rel_tol=TOLERANCE_CELLS / grid.columns) for side in (wide, high)
    ):
        raise InputError(
            f"pixels of {wide:.10g} m × {high:.10g} m are no cells of {lattice.resolution_m:g} m; {REMEDY}"
        )
    return first_cell(grid.bounds.west, grid.bounds.south, lattice, REMEDY)


def _short(frame: str | None) -> str:
    return "no CRS" if frame is None else frame if len(frame) < 40 else frame.split('"')[1]


def _check_heights(heights: Floats) -> None:
    if not np.isfinite(heights).any():
        raise InputError("no pixel has a height; is it the right --band?")
    worst = np.nanmax(np.abs(heights))
    if worst > MAX_Z_M:
        raise InputError(f"a height of {worst:g} m is beyond ±{MAX_Z_M:g} m; if it means unknown, say --nodata")


def _deltas(heights: Floats, first: tuple[int, int], lattice: Lattice, model: Model, wishes: Wishes) -> Iterator[Delta]:
    """A delta for each line of tiles, so that no more than that is in memory as cells."""
    i0, j0 = first
    rows, side = heights.shape[0], lattice.tile_cells
    for y in range(j0 // side, (j0 + rows - 1) // side + 1):
        low, high = max(y * side, j0), min((y + 1) * side, j0 + rows)
        part = heights[low - j0 : high - j0]
        j, i = np.nonzero(np.isfinite(part))
        if len(i):
            points = np.column_stack([lattice.cell_centre(i + i0), lattice.cell_centre(j + low), part[j, i]])
            mapper = Mapper(wishes.robot, lattice, model)
            mapper.integrate(Scan(wishes.stamp_ns, points, Pose.identity()))
            yield mapper.delta()
