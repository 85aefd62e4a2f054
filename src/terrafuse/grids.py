"""Where an array lies in the world: what rasters, ROS maps and windows of a store have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError, MissingExtra
from terrafuse.lattice import MAX_CELL, Lattice
from terrafuse.types import Array, Bounds, Floats

ON_BORDER = 1e-6
"""A place this near to a border between elements, in elements, is on it, whatever rounding says; borders belong to the
element east and north of them."""

NODES = 9
"""Along a side, between which places in another CRS are interpolated."""


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

    def position(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """(column, row) of places in this CRS, counted in elements from the first one's corner: what `place` undoes."""
        a, b, c, d, e, f = self.affine
        determinant = a * e - b * d
        x, y = x - c, y - f
        return (e * x - b * y) / determinant, (a * y - d * x) / determinant

    def elements(self, column: Floats, row: Floats) -> tuple[Array, Array, Array]:
        """(row, column, inside) of the elements in which such positions lie; 0, 0 where outside."""
        a, b, _, d, e, _ = self.affine
        column, row = _element(column, a + b > 0), _element(row, d + e > 0)
        inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        return np.where(inside, row, 0).astype(np.int64), np.where(inside, column, 0).astype(np.int64), inside

    def locate(self, x: Floats, y: Floats) -> tuple[Array, Array, Array]:
        """(row, column, inside) of the elements in which places in this CRS lie; 0, 0 where outside."""
        return self.elements(*self.position(x, y))


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


def located(cells: Grid, grid: Grid) -> tuple[Array, Array, Array]:
    """(row, column, inside), each (rows, columns) of `cells`: the elements of `grid` in which their centres lie."""
    if grid.crs == cells.crs or None in (grid.crs, cells.crs) or min(cells.rows, cells.columns) < 4 * NODES:
        return grid.elements(*_positions(cells, grid, *_centres(cells)))
    return grid.elements(*_interpolated(cells, grid))


def _centres(cells: Grid) -> tuple[Array, Array]:
    row, column = np.mgrid[0 : cells.rows, 0 : cells.columns] + 0.5
    return column, row


def _positions(cells: Grid, grid: Grid, column: Array, row: Array) -> tuple[Floats, Floats]:
    """Positions in `cells` as positions in `grid`."""
    return grid.position(*transformed(*cells.place(column, row), cells.crs, grid.crs))


def _interpolated(cells: Grid, grid: Grid) -> tuple[Floats, Floats]:
    """Positions in `grid` of centres, between nodes that are exact; exact, too, where the element may depend on it."""
    s, t = np.linspace(0.5, cells.columns - 0.5, NODES), np.linspace(0.5, cells.rows - 0.5, NODES)
    nodes = _positions(cells, grid, *np.meshgrid(s, t))
    middles = _positions(cells, grid, *np.meshgrid((s[1:] + s[:-1]) / 2, (t[1:] + t[:-1]) / 2))
    along, up = _between(s, cells.columns), _between(t, cells.rows)
    out, unsure = [], np.zeros((cells.rows, cells.columns), bool)
    for node, middle in zip(nodes, middles, strict=True):
        mean = (node[1:, 1:] + node[1:, :-1] + node[:-1, 1:] + node[:-1, :-1]) / 4
        position = up @ node @ along.T
        # The error is that of a parabola, largest in the middle; four times that leaves room for what is none.
        error = 4 * np.abs(mean - middle).max() + 2 * ON_BORDER
        unsure |= ~(np.abs(position - np.rint(position)) > error)
        out.append(position)
    if unsure.any():
        row, column = np.nonzero(unsure)
        for position, exact in zip(out, _positions(cells, grid, column + 0.5, row + 0.5), strict=True):
            position[unsure] = exact
    return out[0], out[1]


def _between(nodes: Floats, count: int) -> Floats:
    """(count, N): how much of each node's value each of `count` centres takes."""
    return np.array([np.interp(np.arange(count) + 0.5, nodes, one) for one in np.eye(len(nodes))]).T


def bounds_in(grid: Grid, to_crs: str | None) -> Bounds:
    """The bounds of a grid in another CRS, its edges followed at 21 points each; InputError where it has none."""
    s = np.linspace(0, 1, 21)
    u = np.concatenate([s, s, 0 * s, 0 * s + 1]) * grid.columns
    v = np.concatenate([0 * s, 0 * s + 1, s, s]) * grid.rows
    x, y = transformed(*grid.place(u, v), grid.crs, to_crs)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        west, south, east, north = grid.bounds
        raise InputError(
            f"its bounds, {west:g} to {east:g} and {south:g} to {north:g}, have no place in {to_crs or 'the map'}; "
            "cut out the part around the map, or is its CRS another?"
        )
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
    """The window of the cells whose centres lie within bounds. Raises InputError for bounds beyond the lattice."""
    if not all(abs(edge) * lattice.cells_per_m <= MAX_CELL for edge in bounds):
        raise InputError(f"bounds {tuple(bounds)} reach beyond the lattice of {lattice.resolution_m:g} m cells")
    west, south, east, north = (math.ceil(edge * lattice.cells_per_m - 0.5 - ON_BORDER) for edge in bounds)
    return west, south, east, north
