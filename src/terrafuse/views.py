"""Layers of the global map as arrays, assembled tile by tile: what exports, pictures and reports are made from.

Arrays here are [j, i]: row 0 is the southernmost. Whoever writes a raster turns them north-up.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.models.base import Layer
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds, Floats, TileKey

CellWindow = tuple[int, int, int, int]
"""(i0, j0, i1, j1), half open, in cells of the lattice."""


def chosen_layers(replica: Replica, names: Sequence[str] | None) -> list[Layer]:
    """The layers of these names, all of the model's by default; raises InputError for one that there is not."""
    layers = replica.model.layers
    for name in names or ():
        if name not in layers:
            raise InputError(
                f"the model '{replica.model.name}' has no layer '{name}'; it has: {', '.join(layers)}"
            )
    return [layers[name] for name in names or layers]


def cells_with_halo(replica: Replica, key: TileKey, halo: int) -> Array:
    """The cells of a tile and `halo` more on each side, unknown where there is no tile."""
    centre = replica.cells(key)
    if halo == 0:
        return centre
    side = replica.lattice.tile_cells
    if halo > side:
        raise InputError(f"a halo of {halo} cells is more than a tile of {side} has; use larger tiles")
    out = np.zeros((side + 2 * halo, side + 2 * halo), centre.dtype)
    known = set(replica.keys)
    # For each axis and neighbour: where its strip goes, and which part of it that is.
    strips = {
        -1: (slice(0, halo), slice(side - halo, side)),
        0: (slice(halo, halo + side), slice(0, side)),
        1: (slice(halo + side, None), slice(0, halo)),
    }
    for dy, (to_j, from_j) in strips.items():
        for dx, (to_i, from_i) in strips.items():
            neighbour = TileKey(key.x + dx, key.y + dy, key.level)
            if neighbour in known:
                out[to_j, to_i] = replica.cells(neighbour)[from_j, from_i]
    return out


def tile_layers(replica: Replica, key: TileKey, layers: Sequence[Layer]) -> dict[str, Floats]:
    """Each layer of one tile, (T, T)."""
    side = replica.lattice.tile_cells
    out = {}
    for layer in layers:
        cells = cells_with_halo(replica, key, layer.halo)
        values = layer.compute(cells, replica.lattice)
        out[layer.name] = values[layer.halo : layer.halo + side, layer.halo : layer.halo + side]
    return out


def known_window(replica: Replica) -> CellWindow | None:
    """The smallest window that holds every known cell; None of an empty map."""
    side = replica.lattice.tile_cells
    spans = []
    for key in replica.keys:
        known = replica.model.known(replica.cells(key))
        if known.any():
            i, j = np.flatnonzero(known.any(axis=0)), np.flatnonzero(known.any(axis=1))
            spans.append(
                (key.x * side + i[0], key.y * side + j[0], key.x * side + i[-1] + 1, key.y * side + j[-1] + 1)
            )
    if not spans:
        return None
    low, high = np.min(spans, axis=0), np.max(spans, axis=0)
    return int(low[0]), int(low[1]), int(high[2]), int(high[3])


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
    r = replica.lattice.resolution_m
    return Bounds(*(index * r for index in window))


def parts(
    replica: Replica, layers: Sequence[Layer], window: CellWindow
) -> Iterator[tuple[slice, slice, Mapping[str, Floats]]]:
    """(rows, columns, layers) of each tile that meets the window, rows counted from its southern edge."""
    side = replica.lattice.tile_cells
    i0, j0, i1, j1 = window
    for key in replica.keys:
        left, low = key.x * side, key.y * side
        a, b = max(left, i0), min(left + side, i1)
        c, d = max(low, j0), min(low + side, j1)
        if a < b and c < d:
            inside = np.s_[c - low : d - low, a - left : b - left]
            values = {name: array[inside] for name, array in tile_layers(replica, key, layers).items()}
            yield slice(c - j0, d - j0), slice(a - i0, b - i0), values


def mosaic(replica: Replica, layers: Sequence[Layer], window: CellWindow) -> dict[str, Floats]:
    """Each layer over a window, (H, W) float64, NaN where unknown."""
    i0, j0, i1, j1 = window
    out = {layer.name: np.full((j1 - j0, i1 - i0), np.nan) for layer in layers}
    for rows, columns, values in parts(replica, layers, window):
        for name, array in values.items():
            out[name][rows, columns] = array
    return out


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
    for key in replica.keys:
        mask = replica.model.known(replica.cells(key))
        known += int(mask.sum())
        for name, values in tile_layers(replica, key, layers).items():
            valid = values[mask & ~np.isnan(values)]
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
