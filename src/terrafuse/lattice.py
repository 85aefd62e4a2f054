"""World ↔ cell ↔ tile arithmetic.

Cell (i, j) covers [i·r, (i+1)·r) × [j·r, (j+1)·r) metres east and north of the world's origin; tile (x, y) covers
the same way a square of `tile_m`. The lattice has no origin of its own: every robot, session and machine that works in
one CRS at one resolution counts the same cells, so tiles meet without negotiation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from terrafuse.errors import LatticeError
from terrafuse.types import Array, Bounds, TileKey

DEFAULT_TILE_M = 40.0
"""Side of a tile in the *tiles* paper, at 0.1 m."""

MAX_TILE_CELLS = 4096
MAX_CELL = 2**40
"""Millimetre cells reach around the Earth, and sums of indices stay exact in float64."""


def default_tile_m(resolution_m: float) -> float:
    """40 m for robots' maps; 100 cells where cells are so large (over 0.5 m) that a 40 m tile would be mostly edge."""
    return DEFAULT_TILE_M if resolution_m <= 0.5 else 100 * resolution_m


@dataclass(frozen=True)
class Lattice:
    """An immutable lattice of square cells, grouped in square tiles.

    `crs` is None for a local metric frame, else what pyproj understands (EPSG:32632, WKT); it must be metric.
    Raises LatticeError if the resolution does not divide the tile.
    """

    resolution_m: float
    tile_m: float = DEFAULT_TILE_M
    crs: str | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0):
            raise LatticeError(f"resolution {self.resolution_m} m: give a positive number of metres a cell")
        if not (math.isfinite(self.tile_m) and self.tile_m > 0):
            raise LatticeError(f"tile {self.tile_m} m: give a positive number of metres a tile side")
        exact = self.tile_m / self.resolution_m
        if not math.isfinite(exact):
            raise LatticeError(f"cells of {self.resolution_m} m in tiles of {self.tile_m} m are too many to count")
        if round(exact) < 1 or abs(exact - round(exact)) > 1e-6:
            raise LatticeError(self._does_not_divide(exact))
        if round(exact) > MAX_TILE_CELLS:
            raise LatticeError(
                f"a tile of {self.tile_m} m has {round(exact)} cells of {self.resolution_m} m a side; "
                f"at most {MAX_TILE_CELLS}: use a smaller tile or coarser cells"
            )

    def _does_not_divide(self, exact: float) -> str:
        fewer, more = max(1, math.floor(exact)), math.floor(exact) + 1
        return (
            f"resolution {self.resolution_m} m does not divide the tile of {self.tile_m} m ({exact:.3f} cells a side): "
            f"use {self.tile_m / more:.6g} or {self.tile_m / fewer:.6g} m cells, "
            f"or tiles of {fewer * self.resolution_m:.6g} or {more * self.resolution_m:.6g} m"
        )

    @cached_property
    def tile_cells(self) -> int:
        """Cells along a tile's side."""
        return round(self.tile_m / self.resolution_m)

    @cached_property
    def cells_per_m(self) -> float:
        """1/r; cell indices are floor(coordinate · this), which for 0.1 m is the exact ×10 where dividing is not."""
        return 1.0 / self.resolution_m

    def cell(self, coordinate_m: Array | float) -> Array:
        """Index of the cell that holds each coordinate (east or north)."""
        return np.floor(np.asarray(coordinate_m, np.float64) * self.cells_per_m).astype(np.int64)

    def cell_centre(self, index: Array | int) -> Array:
        """Coordinate of the middle of each cell."""
        return (np.asarray(index, np.float64) + 0.5) * self.resolution_m

    def tile_at(self, east_m: float, north_m: float, level: int = 0) -> TileKey:
        i, j = math.floor(east_m * self.cells_per_m), math.floor(north_m * self.cells_per_m)
        return TileKey(i // self.tile_cells, j // self.tile_cells, level)

    def tile_bounds(self, key: TileKey) -> Bounds:
        side = self.tile_cells * self.resolution_m
        return Bounds(key.x * side, key.y * side, (key.x + 1) * side, (key.y + 1) * side)

    def cell_window(self, bounds: Bounds) -> tuple[int, int, int, int]:
        """(i0, j0, i1, j1), half open, of the cells that overlap the bounds; edges on a cell border add no cell."""
        if not all(map(math.isfinite, bounds)):
            raise LatticeError(f"bounds {tuple(bounds)} are not finite; give west,south,east,north in metres")
        slack = 1e-6
        if max(map(abs, bounds)) * self.cells_per_m > MAX_CELL + slack:
            raise LatticeError(f"bounds {tuple(bounds)} reach beyond the lattice of {self.resolution_m} m cells")
        i0 = math.floor(bounds.west * self.cells_per_m + slack)
        j0 = math.floor(bounds.south * self.cells_per_m + slack)
        i1 = math.ceil(bounds.east * self.cells_per_m - slack)
        j1 = math.ceil(bounds.north * self.cells_per_m - slack)
        if i1 <= i0 or j1 <= j0:
            raise LatticeError(f"bounds {tuple(bounds)} hold no cell; give west,south,east,north in metres")
        return i0, j0, i1, j1

    def coarser(self, factor: int) -> Lattice:
        """The lattice whose cells are `factor`×`factor` of these, in the same tiles."""
        if factor < 1 or self.tile_cells % factor:
            raise LatticeError(f"factor {factor} does not divide the {self.tile_cells} cells of a tile's side")
        return Lattice(self.resolution_m * factor, self.tile_m, self.crs)


def union(keys: list[TileKey], lattice: Lattice) -> Bounds | None:
    """The bounds of all these tiles, None of none."""
    if not keys:
        return None
    first = lattice.tile_bounds(TileKey(min(k.x for k in keys), min(k.y for k in keys)))
    last = lattice.tile_bounds(TileKey(max(k.x for k in keys), max(k.y for k in keys)))
    return first.union(last)
