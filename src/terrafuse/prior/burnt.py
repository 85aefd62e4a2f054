"""Polygons laid upon a lattice, and burnt into its tiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from terrafuse.errors import InputError
from terrafuse.grids import transformed
from terrafuse.kernels.polygons import burn
from terrafuse.lattice import MAX_CELL, Lattice
from terrafuse.prior.source import Extent
from terrafuse.types import Array, Bounds, Floats, TileKey

Polygons = tuple[tuple[Floats, ...], ...]
"""Of a feature: each a list of rings (N, 2), the outer one first."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Of some polygons, in the order of the file: what `kernels.polygons.burn` takes."""

    ends: Floats
    """(E, 4) x, y of the lower and of the upper end, in cells; level ones are left out."""
    polygon: Array
    """(E,) which of the polygons each belongs to, rising."""
    windows: Array
    """(Q, 4) i0, j0, i1, j1 of the cells whose centres each polygon may reach."""
    values: Floats
    """(Q, P) NaN where a polygon says nothing."""

    @cached_property
    def first(self) -> Array:
        """(Q + 1,) the first edge of each polygon."""
        return np.searchsorted(self.polygon, np.arange(len(self.windows) + 1))

    def meeting(self, low: int, high: int) -> Edges:
        """Those that meet the rows of cells from `low` up to below `high`."""
        kept = np.flatnonzero((self.windows[:, 1] < high) & (self.windows[:, 3] > low))
        number = np.full(len(self.windows), -1)
        number[kept] = np.arange(len(kept))
        met = (self.ends[:, 1] < high) & (self.ends[:, 3] > low) & (number[self.polygon] >= 0)
        return Edges(self.ends[met], number[self.polygon[met]], self.windows[kept], self.values[kept])


class PlacedPolygons:
    """Tiles are best asked for line by line: the edges that meet a line are looked for once."""

    def __init__(self, edges: Edges, extents: Sequence[Extent], lattice: Lattice) -> None:
        self.edges = edges
        self._extents = extents
        self._side = lattice.tile_cells
        self._line: tuple[int, Edges] | None = None

    def extents(self) -> Sequence[Extent]:
        return self._extents

    def values(self, key: TileKey) -> Floats:
        """(P, T²); NaN where no polygon says anything."""
        line, side = self._line_of(key.y), self._side
        out = np.full((line.values.shape[1], side, side), np.nan)
        burn(out, key.x * side, key.y * side, line.ends, line.first, line.windows, line.values)
        return out.reshape(len(out), -1)

    def _line_of(self, y: int) -> Edges:
        if self._line is None or self._line[0] != y:
            self._line = y, self.edges.meeting(y * self._side, (y + 1) * self._side)
        return self._line[1]


def lay(features: Sequence[Polygons], values: Floats, crs: str | None, lattice: Lattice, what: str) -> PlacedPolygons:
    """Features of these values (F, P) on a lattice; errors call the first one `what` 1."""
    polygons = [polygon for feature in features for polygon in feature]
    feature_of = np.repeat(np.arange(len(features)), [len(feature) for feature in features])
    rings = [ring for polygon in polygons for ring in polygon]
    polygon_of = np.repeat(np.arange(len(polygons)), [len(polygon) for polygon in polygons])
    here = np.concatenate(rings)
    points = np.stack(transformed(here[:, 0], here[:, 1], crs, lattice.crs), axis=1)
    starts = np.cumsum([0, *(len(ring) for ring in rings)])
    firsts = starts[:-1][np.searchsorted(polygon_of, np.arange(len(polygons)))]
    _check_places(here, points, firsts, feature_of, lattice, crs, what)
    windows = _windows(points * lattice.cells_per_m, firsts)
    ends, ring_of = _ends(points * lattice.cells_per_m, starts)
    edges = Edges(ends, polygon_of[ring_of], windows, values[feature_of])
    return PlacedPolygons(edges, _extents(points, windows, firsts, feature_of, what), lattice)


def _check_places(
    here: Floats, points: Floats, firsts: Array, feature_of: Array, lattice: Lattice, crs: str | None, what: str
) -> None:
    """Raise InputError for a feature without a place on the lattice."""
    lost = ~(np.abs(points) * lattice.cells_per_m <= MAX_CELL).all(axis=1)
    if lost.any():
        polygon = int(np.searchsorted(firsts, np.flatnonzero(lost)[0], side="right")) - 1
        x, y = here[np.flatnonzero(lost)[0]]
        raise InputError(
            f"{what} {feature_of[polygon] + 1}: ({x:g}, {y:g}){f' in {crs[:40]}' if crs else ''} has no place in "
            f"{lattice.crs[:40] if lattice.crs else 'the map'}; are these its coordinates, and is its CRS right?"
        )


def _windows(points: Floats, firsts: Array) -> Array:
    """(Q, 4) of polygons whose points (N, 2), in cells, begin at `firsts`."""
    low, high = np.minimum.reduceat(points, firsts), np.maximum.reduceat(points, firsts)
    return np.ceil(np.concatenate([low, high], axis=1) - 0.5).astype(np.int64)


def _ends(points: Floats, starts: Array) -> tuple[Floats, Array]:
    """((E, 4) edges from their lower to their upper end, (E,) rings) of rings that begin at `starts`, each closed."""
    after = np.arange(1, len(points) + 1)
    after[starts[1:] - 1] = starts[:-1]
    ring = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    one, other = points, points[after]
    upward = (one[:, 1] < other[:, 1])[:, None]
    ends = np.concatenate([np.where(upward, one, other), np.where(upward, other, one)], axis=1)
    sloped = ends[:, 1] < ends[:, 3]
    return ends[sloped], ring[sloped]


def _extents(points: Floats, windows: Array, firsts: Array, feature_of: Array, what: str) -> list[Extent]:
    """Of each feature."""
    first = np.searchsorted(feature_of, np.arange(feature_of[-1] + 1))
    low = np.minimum.reduceat(np.minimum.reduceat(points, firsts), first).tolist()
    high = np.maximum.reduceat(np.maximum.reduceat(points, firsts), first).tolist()
    a = np.minimum.reduceat(windows[:, :2], first).tolist()
    b = np.maximum.reduceat(windows[:, 2:], first).tolist()
    return [Extent(f"{what} {k + 1}", Bounds(*low[k], *high[k]), (*a[k], *b[k])) for k in range(len(first))]
