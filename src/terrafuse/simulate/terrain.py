"""Ground as a heightfield: a square net of heights, each square of it two triangles.

The surface is these triangles, for rays, for the truth and for wheels alike: no smoother one is meant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels.ground import on_triangles
from terrafuse.raster import Raster, read_raster
from terrafuse.simulate.noise import Octave, axis, octaves
from terrafuse.types import Array, Bounds, Floats


@dataclass(frozen=True, eq=False)
class Terrain:
    """`heights_m` (R, C) [j, i] at the corners of squares, the first at (west_m, south_m).

    A square is cut from its south-western to its north-eastern corner. Raises InputError for what is no surface.
    """

    west_m: float
    south_m: float
    step_m: float
    heights_m: Floats

    def __post_init__(self) -> None:
        if not (math.isfinite(self.step_m) and self.step_m > 0):
            raise InputError(f"terrain step {self.step_m} m: give a positive number of metres")
        if self.heights_m.ndim != 2 or min(self.heights_m.shape) < 2:
            raise InputError(f"terrain of {self.heights_m.shape} heights: give at least 2×2")
        if not np.isfinite(self.heights_m).all():
            raise InputError("terrain has heights that are not finite; fill the gaps before (gdal_fillnodata.py)")
        self.heights_m.flags.writeable = False

    @property
    def bounds(self) -> Bounds:
        rows, columns = self.heights_m.shape
        east, north = self.west_m + (columns - 1) * self.step_m, self.south_m + (rows - 1) * self.step_m
        return Bounds(self.west_m, self.south_m, east, north)

    @property
    def axes_m(self) -> tuple[Floats, Floats]:
        """x (C,) and y (R,) of the corners."""
        rows, columns = self.heights_m.shape
        x, y = self.west_m + self.step_m * np.arange(columns), self.south_m + self.step_m * np.arange(rows)
        return np.asarray(x), np.asarray(y)

    def height(self, x_m: Array | float, y_m: Array | float) -> Floats:
        """z at (x, y), of their common shape; NaN outside."""
        return self.surface(x_m, y_m)[0]

    def surface(self, x_m: Array | float, y_m: Array | float) -> tuple[Floats, Floats, Floats]:
        """z, dz/dx and dz/dy, each of the common shape of x and y; NaN outside."""
        shape = np.broadcast_shapes(np.shape(x_m), np.shape(y_m))
        x, y = (np.array(np.broadcast_to(part, shape), np.float64) for part in (x_m, y_m))
        out = tuple(np.empty(x.shape) for _ in range(3))
        flat_out = (part.reshape(-1) for part in out)
        on_triangles(self.heights_m, self.west_m, self.south_m, self.step_m, x.reshape(-1), y.reshape(-1), *flat_out)
        return out  # type: ignore[return-value]


def flat(bounds: Bounds, z_m: float = 0.0) -> Terrain:
    """Level ground over at least these bounds."""
    side = max(bounds.east - bounds.west, bounds.north - bounds.south)
    return Terrain(bounds.west, bounds.south, side, np.full((2, 2), z_m))


def rolling(bounds: Bounds, step_m: float, parts: tuple[Octave, ...], seed: int, level_m: float = 0.0) -> Terrain:
    """Random hills over at least these bounds: the sum of some octaves of noise."""
    x, y = axis(bounds.west, bounds.east, step_m), axis(bounds.south, bounds.north, step_m)
    return Terrain(bounds.west, bounds.south, step_m, level_m + octaves(x, y, parts, seed))


def terrain_of(file: Path | str, bounds: Bounds | None = None, band: str | None = None) -> tuple[Terrain, str | None]:
    """The terrain of a DEM that GDAL opens, its pixels' centres as corners, and its CRS; all of it, or what the bounds
    need. Raises InputError for a raster that is not north-up, not metric or not square."""
    raster = read_raster(file, band)
    _check(raster, file)
    a, _, c, _, _, f = raster.grid.affine
    heights = raster.values[::-1]
    west, south = c + a / 2, f - a * (raster.grid.rows - 0.5)
    terrain_bounds = Bounds(west, south, west + a * (heights.shape[1] - 1), south + a * (heights.shape[0] - 1))
    i0, j0, i1, j1 = _part(terrain_bounds, bounds or terrain_bounds, a, file)
    part = np.ascontiguousarray(heights[j0 : j1 + 1, i0 : i1 + 1])
    if np.isnan(part).any():
        raise InputError(
            f"{file}: {int(np.isnan(part).sum())} of its heights are missing there; fill them (gdal_fillnodata.py) "
            "or give bounds without gaps"
        )
    return Terrain(west + i0 * a, south + j0 * a, a, part), raster.grid.crs


def _check(raster: Raster, file: Path | str) -> None:
    if not raster.grid.straight:
        raise InputError(f"{file}: is not north-up; warp it (gdalwarp {file} straight.tif)")
    if raster.grid.crs is not None and _geographic(raster.grid.crs):
        raise InputError(
            f"{file}: counts in degrees ({raster.grid.crs}); warp it to metres (gdalwarp -t_srs EPSG:326..)"
        )
    wide, tall = raster.grid.sides_m
    if abs(wide - tall) > 1e-6 * wide:
        raise InputError(
            f"{file}: pixels of {wide:g} m × {tall:g} m; warp it to squares (gdalwarp -tr {wide:g} {wide:g})"
        )


def _geographic(crs: str) -> bool:
    import pyproj

    return bool(pyproj.CRS.from_user_input(crs).is_geographic)


def _part(have: Bounds, want: Bounds, step_m: float, file: Path | str) -> tuple[int, int, int, int]:
    """(i0, j0, i1, j1), closed, of the corners that a surface over `want` needs."""
    slack = 1e-6 * step_m
    if want.west < have.west - slack or want.south < have.south - slack:
        raise InputError(f"{file}: its heights cover {tuple(have)}, not the bounds {tuple(want)}")
    if want.east > have.east + slack or want.north > have.north + slack or want.east <= want.west:
        raise InputError(f"{file}: its heights cover {tuple(have)}, not the bounds {tuple(want)}")
    i0, j0 = (math.floor((a - b) / step_m + 1e-6) for a, b in ((want.west, have.west), (want.south, have.south)))
    i1, j1 = (math.ceil((a - b) / step_m - 1e-6) for a, b in ((want.east, have.west), (want.north, have.south)))
    return i0, j0, i1, j1
