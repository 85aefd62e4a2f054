"""Layers of the global map as arrays, assembled tile by tile: what exports, pictures and reports are made from.

Arrays here are [j, i]: row 0 is the southernmost. Whoever writes a raster turns them north-up.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby

import numpy as np

from terrafuse.errors import InputError
from terrafuse.models.base import Layer
from terrafuse.models.layers import layers_of
from terrafuse.replica import Replica
from terrafuse.tile import opaque
from terrafuse.types import Array, Bounds, Floats, TileKey

CellWindow = tuple[int, int, int, int]
"""(i0, j0, i1, j1), half open, in cells of the lattice."""

BLOCK = 100
"""Layers are computed in blocks of this side: 0.9 MB of elevation cells stay in a processor's cache, and blocks that
nobody saw are skipped."""

STRIPE = 3
"""Tiles are visited in stripes of this width, line by line: three lines of a stripe and its rims are 15 tiles,
which a replica keeps, so that a layer that looks at neighbours has a tile folded less than twice."""

MAX_ARRAY_CELLS = 2**30
"""8 GiB of float64; a larger window is a mistake more often than a wish."""


def chosen_layers(replica: Replica, names: Sequence[str] | None) -> list[Layer]:
    """The layers of these names, all there are by default; raises InputError for one that there is not."""
    layers = layers_of(replica.model)
    for name in names or ():
        if name not in layers:
            raise InputError(f"the model '{replica.model.name}' has no layer '{name}'; it has: {', '.join(layers)}")
    return [layers[name] for name in names or layers]


def known_window(replica: Replica) -> CellWindow | None:
    """The smallest window that holds every known cell; None of an empty map."""

    @cache
    def span(key: TileKey) -> CellWindow | None:
        side = replica.lattice.tile_cells
        return _extent(replica.model.known(replica.cells(key)), key.x * side, key.y * side)

    def edge(line: Callable[[TileKey], int], side: int, outermost: Callable[[list[int]], int]) -> int | None:
        """Only the outer lines of tiles are looked at, from outside in, up to the first that holds a known cell."""
        for _, keys in groupby(sorted(replica.keys, key=line), line):
            if found := [window[side] for key in keys if (window := span(key))]:
                return outermost(found)
        return None

    west, south = edge(lambda key: key.x, 0, min), edge(lambda key: key.y, 1, min)
    east, north = edge(lambda key: -key.x, 2, max), edge(lambda key: -key.y, 3, max)
    if west is None or south is None or east is None or north is None:
        return None
    return west, south, east, north


def _extent(known: Array, left: int, low: int) -> CellWindow | None:
    """The smallest window around what is True in a mask (H, W) whose first cell is (left, low)."""
    i, j = np.flatnonzero(known.any(axis=0)), np.flatnonzero(known.any(axis=1))
    if not len(i):
        return None
    return left + int(i[0]), low + int(j[0]), left + int(i[-1]) + 1, low + int(j[-1]) + 1


def window_of(replica: Replica, bounds: Bounds | None) -> CellWindow:
    """The cells of the bounds, or of all that is known. Raises InputError for an empty map without bounds."""
    if bounds is not None:
        return replica.lattice.cell_window(bounds)
    window = known_window(replica)
    if window is None:
        raise InputError("the map is empty: no robot has reported a cell")
    return window


def bounds_of(replica: Replica, window: CellWindow) -> Bounds:
    """The rectangle that a window covers, metres."""
    r, per_m = replica.lattice.resolution_m, replica.lattice.cells_per_m
    # 0.1 is no binary number, 10 is: 40000093 / 10 is 4000009.3, but 40000093 · 0.1 is 4000009.3000000003.
    return Bounds(*(index / per_m if per_m.is_integer() else index * r for index in window))


def shape_of(window: CellWindow) -> tuple[int, int]:
    """(rows, columns)."""
    i0, j0, i1, j1 = window
    return j1 - j0, i1 - i0


def cells_in(replica: Replica, window: CellWindow, keys: Collection[TileKey]) -> Array:
    """The cells of a window, unknown where there is no tile; `keys` are the replica's."""
    side = replica.lattice.tile_cells
    i0, j0, i1, j1 = window
    out = np.zeros(shape_of(window), replica.model.cell)
    for y in range(j0 // side, (j1 - 1) // side + 1):
        for x in range(i0 // side, (i1 - 1) // side + 1):
            key = TileKey(x, y)
            if key in keys:
                to, inside = _meet(key, side, window)
                opaque(out)[to] = opaque(replica.cells(key))[inside]
    return out


def _meet(key: TileKey, side: int, window: CellWindow) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """(rows, columns) of what a tile and a window share, counted in the window and counted in the tile."""
    i0, j0, i1, j1 = window
    left, low = key.x * side, key.y * side
    a, b = max(left, i0), min(left + side, i1)
    c, d = max(low, j0), min(low + side, j1)
    return (slice(c - j0, d - j0), slice(a - i0, b - i0)), (slice(c - low, d - low), slice(a - left, b - left))


def known_values(
    replica: Replica, key: TileKey, layers: Sequence[Layer], keys: Collection[TileKey]
) -> tuple[Array, dict[str, Floats]]:
    """(flat positions, the values of each layer there) of a tile's known cells, (K,) each; `keys` are the replica's."""
    cells = replica.cells(key)
    known = replica.model.known(cells)
    at = np.flatnonzero(known)
    alone = [layer for layer in layers if not layer.halo]
    among = {layer.name: _among(replica, key, known, layer, keys)[at] for layer in layers if layer.halo}
    return at, _alone(replica, cells.reshape(-1), at, alone) | among


def _alone(replica: Replica, cells: Array, at: Array, layers: Sequence[Layer]) -> dict[str, Floats]:
    """Layers that look at no neighbours, at these positions."""
    out = {layer.name: np.empty(len(at)) for layer in layers}
    for first in range(0, len(at) if layers else 0, BLOCK**2):
        some = slice(first, first + BLOCK**2)
        part = opaque(cells)[at[some]].view(cells.dtype).reshape(1, -1)
        for layer in layers:
            out[layer.name][some] = layer.compute(part, replica.reading)[0]
    return out


def _among(replica: Replica, key: TileKey, known: Array, layer: Layer, keys: Collection[TileKey]) -> Floats:
    """A layer that looks at neighbours, flat, computed around the known cells of each block of the tile."""
    side, halo = replica.lattice.tile_cells, layer.halo
    out = np.full((side, side), np.nan)
    for j in range(0, side, BLOCK):
        for i in range(0, side, BLOCK):
            window = _extent(known[j : j + BLOCK, i : i + BLOCK], i, j)
            if window is not None:
                i0, j0, i1, j1 = window
                left, low = key.x * side - halo, key.y * side - halo
                around = (left + i0, low + j0, left + i1 + 2 * halo, low + j1 + 2 * halo)
                values = layer.compute(cells_in(replica, around, keys), replica.reading)
                out[j0:j1, i0:i1] = values[halo:-halo, halo:-halo]
    return out.reshape(-1)


def tile_layers(
    replica: Replica, key: TileKey, layers: Sequence[Layer], keys: Collection[TileKey] | None = None
) -> dict[str, Floats]:
    """Each layer of one tile, (T, T), NaN where nobody saw the cell itself.

    `keys` are the replica's, for callers that go through many tiles.
    """
    side = replica.lattice.tile_cells
    at, values = known_values(replica, key, layers, frozenset(replica.keys) if keys is None else keys)
    out = {}
    for name, some in values.items():
        out[name] = np.full((side, side), np.nan)
        out[name].reshape(-1)[at] = some
    return out


def keys_in(replica: Replica, window: CellWindow) -> list[TileKey]:
    """The tiles that meet a window."""
    side = replica.lattice.tile_cells
    i0, j0, i1, j1 = window
    return [
        key
        for key in replica.keys
        if i0 < (key.x + 1) * side and key.x * side < i1 and j0 < (key.y + 1) * side and key.y * side < j1
    ]


def parts(
    replica: Replica, layers: Sequence[Layer], window: CellWindow
) -> Iterator[tuple[slice, slice, Mapping[str, Floats]]]:
    """(rows, columns, layers) of each tile that meets the window, rows counted from its southern edge."""
    side = replica.lattice.tile_cells
    known = frozenset(replica.keys)
    for key in _in_stripes(keys_in(replica, window)):
        (rows, columns), inside = _meet(key, side, window)
        values = tile_layers(replica, key, layers, known)
        yield rows, columns, {name: array[inside] for name, array in values.items()}


def _in_stripes(keys: Sequence[TileKey]) -> list[TileKey]:
    """In stripes along the longer side of the map; a single one where the shorter side is a stripe and its rims."""
    spread = [[key[axis] for key in keys] or [0] for axis in (0, 1)]
    short, long = sorted((0, 1), key=lambda axis: max(spread[axis]) - min(spread[axis]))
    low, rows = min(spread[short]), max(spread[short]) - min(spread[short]) + 1
    stripe = STRIPE if rows > STRIPE + 2 else rows
    return sorted(keys, key=lambda key: ((key[short] - low) // stripe, key[long], key[short]))


def mosaic(replica: Replica, layers: Sequence[Layer], window: CellWindow) -> dict[str, Floats]:
    """Each layer over a window, (H, W) float64, NaN where unknown. Raises InputError if no memory would hold that."""
    height, width = shape_of(window)
    if height * width * len(layers) > MAX_ARRAY_CELLS:
        raise InputError(
            f"{len(layers)} layers of {width}×{height} cells are too much for arrays in memory: "
            "give bounds, fewer layers, or write a GeoTIFF"
        )
    out = {layer.name: np.full((height, width), np.nan) for layer in layers}
    for rows, columns, values in parts(replica, layers, window):
        for name, array in values.items():
            out[name][rows, columns] = array
    return out


def reduced(replica: Replica, layer: Layer, window: CellWindow, factor: int) -> Floats:
    """The mean of a layer's known cells in each `factor`×`factor` block of a window, NaN where none is.

    Blocks count from the window's south-western corner; those at the far edges may be smaller.
    """
    height, width = shape_of(window)
    shape = -(-height // factor), -(-width // factor)
    total, count = np.zeros(shape), np.zeros(shape)
    for rows, columns, values in parts(replica, [layer], window):
        array = values[layer.name]
        known = ~np.isnan(array)
        to = (
            slice(rows.start // factor, (rows.stop - 1) // factor + 1),
            slice(columns.start // factor, (columns.stop - 1) // factor + 1),
        )
        total[to] += _block_sums(np.where(known, array, 0.0), rows.start, columns.start, factor)
        count[to] += _block_sums(known.astype(np.float64), rows.start, columns.start, factor)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / count


def _block_sums(values: Floats, first_row: int, first_column: int, factor: int) -> Floats:
    """Sums over the blocks that an array meets which starts at this row and column of the blocks' raster."""
    for axis, first in enumerate((first_row, first_column)):
        borders = np.arange(-(first % factor), values.shape[axis], factor).clip(0)
        values = np.add.reduceat(values, borders, axis=axis)
    return values


@dataclass(frozen=True)
class LayerStatistics:
    """Over the known cells."""

    unit: str
    min: float | None
    mean: float | None
    max: float | None
    cells: int


def statistics(replica: Replica) -> tuple[int, dict[str, LayerStatistics]]:
    """(known cells, statistics of every layer) of the whole map, tile by tile."""
    layers = chosen_layers(replica, None)
    known = 0
    low = dict.fromkeys((layer.name for layer in layers), np.inf)
    high = dict.fromkeys(low, -np.inf)
    total, count = dict.fromkeys(low, 0.0), dict.fromkeys(low, 0)
    keys = frozenset(replica.keys)
    for key in _in_stripes(replica.keys):
        at, values = known_values(replica, key, layers, keys)
        known += len(at)
        for name, some in values.items():
            valid = some[~np.isnan(some)]
            if len(valid):
                low[name] = min(low[name], float(valid.min()))
                high[name] = max(high[name], float(valid.max()))
                total[name] += float(valid.sum())
                count[name] += len(valid)
    return known, {
        layer.name: LayerStatistics(layer.unit, low[layer.name], total[layer.name] / n, high[layer.name], n)
        if (n := count[layer.name])
        else LayerStatistics(layer.unit, None, None, None, 0)
        for layer in layers
    }
