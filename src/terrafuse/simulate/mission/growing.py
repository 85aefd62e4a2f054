"""The station's map as an image that is kept up to date: only tiles that changed are looked at again."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from terrafuse import views
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer
from terrafuse.prior import ROBOT as PRIOR
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds, Floats, TileKey


class GrowingMap:
    """A layer of a replica over fixed bounds; pixels are blocks of cells, so that no side has more than `most_pixels`
    as long as a tile is one at least.

    Right for layers that look at no neighbours and don't age.
    """

    def __init__(self, replica: Replica, layer: Layer, bounds: Bounds, most_pixels: int) -> None:
        self._replica, self._layer = replica, layer
        self._side = replica.lattice.tile_cells
        i0, j0, i1, j1 = replica.lattice.cell_window(bounds)
        self._factor = _factor(self._side, max(i1 - i0, j1 - j0), most_pixels)
        self._i0, self._j0 = i0 // self._factor, j0 // self._factor
        shape = -(-j1 // self._factor) - self._j0, -(-i1 // self._factor) - self._i0
        self.values: Floats = np.full(shape, np.nan)
        """(H, W): means of the known cells of each block, NaN unknown; row 0 in the south."""
        self.seen: Array = np.zeros(shape, bool)
        """Which blocks a robot saw; the others are as the prior has them."""
        self._version: Hashable = None
        self._held: dict[str, dict[TileKey, int]] = {}

    @property
    def pixel_m(self) -> float:
        return self._factor * self._replica.lattice.resolution_m

    @property
    def lattice(self) -> Lattice:
        """Whose cells are the pixels."""
        return self._replica.lattice.coarser(self._factor)

    @property
    def window(self) -> views.CellWindow:
        """The image's, in cells of `lattice`."""
        rows, columns = self.values.shape
        return self._i0, self._j0, self._i0 + columns, self._j0 + rows

    @property
    def corner_m(self) -> tuple[float, float]:
        """West and south of the image."""
        return self._i0 * self.pixel_m, self._j0 * self.pixel_m

    def update(self) -> None:
        """Take in what the replica learnt since the last call."""
        version = self._replica.store.version()
        if version != self._version:
            self._version = version
            keys = frozenset(self._replica.keys)
            for key in sorted(self._changed()):
                self._draw(key, keys)

    def _changed(self) -> set[TileKey]:
        store = self._replica.store
        held = {robot: store.revisions(robot) for robot in self._replica.robots}
        out = {
            key
            for robot, tiles in held.items()
            for key, revision in tiles.items()
            if self._held.get(robot, {}).get(key) != revision
        }
        self._held = held
        return out

    def _draw(self, key: TileKey, keys: frozenset[TileKey]) -> None:
        cells = self._side**2
        values, seen = np.full(cells, np.nan), np.zeros(cells)
        at, found = views.known_values(self._replica, key, [self._layer], keys)
        values[at] = found[self._layer.name]
        for robot in self._replica.robots:
            if robot != PRIOR and (part := self._replica.store.load(robot, key)) is not None:
                seen[part.at] = 1.0
        self._put(key, self.values, self._blocks(values))
        self._put(key, self.seen, self._blocks(seen) > 0)

    def _blocks(self, values: Floats) -> Floats:
        """Means of the known cells of a tile's blocks."""
        k, n = self._factor, self._side // self._factor
        parts = values.reshape(n, k, n, k)
        known = np.isfinite(parts)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(known, parts, 0.0).sum((1, 3)) / known.sum((1, 3)))

    def _put(self, key: TileKey, image: Array, part: Array) -> None:
        rows, columns = image.shape
        n = self._side // self._factor
        i, j = key.x * n - self._i0, key.y * n - self._j0
        a, b, c, d = max(i, 0), min(i + n, columns), max(j, 0), min(j + n, rows)
        if a < b and c < d:
            image[c:d, a:b] = part[c - j : d - j, a - i : b - i]


def _factor(tile_cells: int, cells: int, most_pixels: int) -> int:
    """The least divisor of a tile's cells that makes so many cells fit so many pixels."""
    divisors = [k for k in range(1, tile_cells + 1) if tile_cells % k == 0]
    return next((k for k in divisors if cells <= k * most_pixels), tile_cells)
