"""Where an array lies in the world: what rasters, ROS maps and windows of a store have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError, MissingExtra
from terrafuse.lattice import Lattice
from terrafuse.types import Array, Bounds, Floats

ON_BORDER = 1e-6
"""A place this near to a border between elements, in elements, is on it, whatever rounding says; borders belong to the
element east and north of them."""


@dataclass(frozen=True)
class Grid:
    """(rows, columns) elements; `affine` (a, b, c, d, e, f) takes (column, row), counted to an element's corner, to
    (x, y) = (a·column + b·row + c, d·column + e·row + f), as in GDAL and rasterio. Row 0 is the first of the array."""

    rows: int
    columns: int
    affine: tuple[float, float, float, float, float, float]
    crs: str | None = None

    @property
    def straight(self) -> bool:
        """Whether rows run west to east and columns north to south."""
        a, b, _, d, e, _ = self.affine
        return b == 0 and d == 0 and a > 0 and e < 0

    @property
    def sides_m(self) -> tuple[float, float]:
        """Lengths of an element's sides, along a row and along a column."""
        a, b, _, d, e, _ = self.affine
        return math.hypot(a, d), math.hypot(b, e)

    @property
    def bounds(self) -> Bounds:
        x, y = self.place(np.array([0, self.columns, 0, self.columns]), np.array([0, 0, self.rows, self.rows]))
        return Bounds(float(x.min()), float(y.min()), float(x.max()), float(y.max()))

    def part(self, row: int, column: int, last_row: int, last_column: int) -> Grid:
        """The grid of a part, half open, which may reach beyond this one."""
        a, b, c, d, e, f = self.affine
        first = a * column + b * row + c, d * column + e * row + f
        return Grid(last_row - row, last_column - column, (a, b, first[0], d, e, first[1]), self.crs)

    def place(self, column: Array, row: Array) -> tuple[Floats, Floats]:
        """(x, y) of positions counted in elements from the first one's corner."""
        a, b, c, d, e, f = self.affine
        return np.asarray(a * column + b * row + c), np.asarray(d * column + e * row + f)

    def centres(self, first_row: int, last_row: int) -> tuple[Floats, Floats]:
        """(x, y), each (last − first, columns), of the centres of some rows, which need not be within the grid."""
        row, column = np.mgrid[first_row:last_row, 0 : self.columns] + 0.5
        return self.place(column, row)

    def locate(self, x: Floats, y: Floats) -> tuple[Array, Array, Array]:
        """(row, column, inside) of the elements in which places in this CRS lie; 0, 0 where outside."""
        a, b, c, d, e, f = self.affine
        determinant = a * e - b * d
        x, y = x - c, y - f
        column = _element((e * x - b * y) / determinant, a + b > 0)
        row = _element((a * y - d * x) / determinant, d + e > 0)
        inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        return np.where(inside, row, 0).astype(np.int64), np.where(inside, column, 0).astype(np.int64), inside


def _element(exact: Floats, rising: bool) -> Floats:
    """Which element: on a border, the one whose coordinate is larger."""
    return np.floor(exact + ON_BORDER) if rising else np.ceil(exact - ON_BORDER) - 1


def transformed(x: Floats, y: Floats, from_crs: str | None, to_crs: str | None) -> tuple[Floats, Floats]:
    """Places in another CRS, any that pyproj knows; None is taken to be the other one."""
    if from_crs is None or to_crs is None or from_crs == to_crs:
        return x, y
    try:
        import pyproj
    except ImportError as error:
        raise MissingExtra("another CRS", "pyproj", "gis") from error
    try:
        out = pyproj.Transformer.from_crs(from_crs, to_crs, always_xy=True).transform(x, y)
    except pyproj.exceptions.ProjError as error:
        raise InputError(f"no way from {from_crs} to {to_crs}: {error}; bring both to one CRS before") from error
    return np.asarray(out[0]), np.asarray(out[1])


def bounds_in(grid: Grid, to_crs: str | None) -> Bounds:
    """The bounds of a grid in another CRS, its edges followed at 21 points each."""
    s = np.linspace(0, 1, 21)
    u = np.concatenate([s, s, 0 * s, 0 * s + 1]) * grid.columns
    v = np.concatenate([0 * s, 0 * s + 1, s, s]) * grid.rows
    x, y = transformed(*grid.place(u, v), grid.crs, to_crs)
    return Bounds(float(x.min()), float(y.min()), float(x.max()), float(y.max()))


def window_grid(lattice: Lattice, window: tuple[int, int, int, int]) -> Grid:
    """The grid of a window (i0, j0, i1, j1) of cells, row 0 the northernmost."""
    i0, j0, i1, j1 = window
    west, north = corner(lattice, i0), corner(lattice, j1)
    r = lattice.resolution_m
    return Grid(j1 - j0, i1 - i0, (r, 0.0, west, 0.0, -r, north), lattice.crs)


def corner(lattice: Lattice, index: int) -> float:
    """Coordinate of a cell's southern or western border."""
    # 0.1 is no binary number, 10 is: 40000093 / 10 is 4000009.3, but 40000093 · 0.1 is 4000009.3000000003.
    per_m = lattice.cells_per_m
    return index / per_m if per_m.is_integer() else index * lattice.resolution_m


def covered(bounds: Bounds, lattice: Lattice) -> tuple[int, int, int, int]:
    """The window of the cells whose centres lie within bounds."""
    west, south, east, north = (math.ceil(edge * lattice.cells_per_m - 0.5 - ON_BORDER) for edge in bounds)
    return west, south, east, north
