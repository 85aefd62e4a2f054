"""The cells of a scan's rays, by tile.

A scan of ordinary reach lists its cells as it meets them, and the list is divided into tiles. One that crosses more
than LISTED_CELLS leaves its cells in the window, where each tile is read when it is asked for: then no scan needs more
memory than a byte a cell of its window, at most 105 MB, and the list.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit

from terrafuse.kernels.grouping import add_up, table_size, tile_number
from terrafuse.kernels.rays import HIT, extent, trace
from terrafuse.types import Array

LISTED_CELLS = 1 << 21
"""With 13 bytes a cell, 27 MB."""


@njit(cache=True, nogil=True)
def group(places, hits, i0, j0, width, side, seen, seats, keys, starts, tile_of, at, hit):
    """Window indices (K,) → flat positions in tiles, by tile: writes keys, starts (all 0 before), at and hit, cells
    at[starts[t]:starts[t + 1]] of tile keys[t] each.

    `places` are used up, `seen` is all 0 again. Returns the number of tiles.
    """
    per_column = 1.0 / width
    tiles, tile = 0, -1
    low_i = low_j = np.int64(0)
    for k in range(places.shape[0]):
        place = places[k]
        seen[place] = 0
        # (n + ½)/width is never within rounding of a whole number: this is the integer division, which is slower.
        row = np.int64((place + 0.5) * per_column)
        i, j = i0 + place - row * width, j0 + row
        in_i, in_j = i - low_i, j - low_j
        # Neighbours in the list mostly share a tile: then nothing is divided.
        if tile < 0 or in_i < 0 or in_i >= side or in_j < 0 or in_j >= side:
            x, y = i // side, j // side
            low_i, low_j = x * side, y * side
            in_i, in_j = i - low_i, j - low_j
            tile = tile_number(x, y, tiles, seats, keys)
            tiles += tile == tiles
        tile_of[k] = tile
        starts[tile + 1] += 1
        places[k] = in_j * side + in_i
    cursor = add_up(starts, tiles)
    for k in range(places.shape[0]):
        to = cursor[tile_of[k]]
        cursor[tile_of[k]] += 1
        at[to] = places[k]
        hit[to] = k < hits
    return tiles


@njit(cache=True, nogil=True)
def count_seen(seen, width, height, first_i, first_j, side, across, counts):
    """Add to counts (…·across) how many cells of each tile were seen; the window starts at this cell of the first."""
    for row in range(height):
        tile, column = (first_j + row) // side * across, 0
        while column < width:
            end = min(width, column + side - (first_i + column) % side)
            some = 0
            for k in range(row * width + column, row * width + end):
                some += seen[k] != 0
            counts[tile + (first_i + column) // side] += some
            column = end


@njit(cache=True, nogil=True)
def read_seen(seen, width, west, south, east, north, first_i, first_j, side, at, hit):
    """The cells seen in columns west to east, rows south to north of the window; its first cell is that of a tile."""
    count = 0
    for row in range(south, north):
        for column in range(west, east):
            what = seen[row * width + column]
            if what != 0:
                at[count] = (first_j + row) * side + first_i + column
                hit[count] = what & HIT != 0
                count += 1


@dataclass(frozen=True, eq=False)
class Traced:
    """The cells of a scan's rays, each once, by tile."""

    keys: Array
    """(T, 2) int64 as (x, y)."""
    counts: Array
    """(T,) int64: the cells of each tile."""
    part: Callable[[int], tuple[Array, Array]]
    """Of tile number t, (at (K,) int32, hit (K,) bool): flat positions j·tile_cells + i, and whether a marked segment
    ends there; the other cells are only crossed."""

    @property
    def cells(self) -> int:
        return int(self.counts.sum())


Window = tuple[int, int, int, int]
"""First cell (i, j), columns and rows."""


class Tracer:
    """The rays of one robot's scans; keeps the scratch between them: fresh memory costs more than the work."""

    def __init__(self, cells_per_m: float, tile_cells: int, listed_cells: int = LISTED_CELLS) -> None:
        """`listed_cells`, a power of two, bounds the list; the result is the same."""
        self._cells_per_m, self._side, self._most_listed = cells_per_m, tile_cells, listed_cells
        self._seen = np.zeros(1 << 16, np.uint8)
        self._left_over = 0
        self._places = np.empty(min(1 << 12, listed_cells), np.int32)
        self._grouped = _room(1 << 12)

    def __call__(self, ends: Array, marks: Array) -> Traced:
        """Segments (K, 4) x0 y0 x1 y1 in metres, marks (K,) bool: those that hit the cell that holds their end.

        Segments keep to MAX_RAY_CELLS and MAX_SPREAD_CELLS. What it returns is scratch, and holds until the next scan.
        """
        self._seen[: self._left_over] = 0
        self._left_over = 0
        if not len(ends):
            return _listed(np.empty((0, 2), np.int64), np.zeros(1, np.int64), np.empty(0, np.int32), np.empty(0, bool))
        i0, j0, width, height, most = extent(ends, self._cells_per_m)
        if len(self._seen) < width * height:
            self._seen = np.zeros(1 << (width * height - 1).bit_length(), np.uint8)
        room = min(1 << int(most).bit_length(), self._most_listed)
        if len(self._places) < room:
            self._places = np.empty(room, np.int32)
        hits, count = trace(ends, marks, self._cells_per_m, i0, j0, width, self._seen, self._places)
        if count < len(self._places):
            return self._by_list(count, hits, (i0, j0, width, height))
        self._left_over = width * height
        return self._by_window((i0, j0, width, height))

    def _by_list(self, count: int, hits: int, window: Window) -> Traced:
        i0, j0, width, _ = window
        side, (across, up) = self._side, _tiles(window, self._side)
        if len(self._grouped[0]) < count:
            self._grouped = _room(1 << (count - 1).bit_length())
        tile_of, at, hit = self._grouped
        most = min(count, across * up)
        seats = np.full(table_size(most), -1, np.int32)
        keys, starts = np.empty((most, 2), np.int64), np.zeros(most + 1, np.int64)
        places = self._places[:count]
        tiles = group(places, hits, i0, j0, width, side, self._seen, seats, keys, starts, tile_of, at, hit)
        return _listed(keys[:tiles], starts[: tiles + 1], at[:count], hit[:count])

    def _by_window(self, window: Window) -> Traced:
        i0, j0, width, height = window
        side, (across, up) = self._side, _tiles(window, self._side)
        counts = np.zeros(across * up, np.int64)
        count_seen(self._seen, width, height, i0 % side, j0 % side, side, across, counts)
        y, x = np.divmod(np.flatnonzero(counts), across)
        keys, counts = np.stack([x + i0 // side, y + j0 // side], axis=1), counts[counts > 0]
        return Traced(keys, counts, partial(self._read, window, keys, counts))

    def _read(self, window: Window, keys: Array, counts: Array, t: int) -> tuple[Array, Array]:
        """What is seen in a tile."""
        i0, j0, width, height = window
        side, (x, y) = self._side, keys[t].tolist()
        west, south, first_i, first_j = max(x * side - i0, 0), max(y * side - j0, 0), i0 - x * side, j0 - y * side
        east, north = min((x + 1) * side - i0, width), min((y + 1) * side - j0, height)
        at, hit = np.empty(counts[t], np.int32), np.empty(counts[t], np.bool_)
        read_seen(self._seen, width, west, south, east, north, first_i, first_j, side, at, hit)
        return at, hit


def _listed(keys: Array, starts: Array, at: Array, hit: Array) -> Traced:
    def part(t: int) -> tuple[Array, Array]:
        return at[starts[t] : starts[t + 1]], hit[starts[t] : starts[t + 1]]

    return Traced(keys, np.diff(starts), part)


def _tiles(window: Window, side: int) -> tuple[int, int]:
    """How many tiles a window meets, across and up."""
    i0, j0, width, height = window
    return (i0 + width - 1) // side - i0 // side + 1, (j0 + height - 1) // side - j0 // side + 1


def _room(cells: int) -> tuple[Array, Array, Array]:
    """(tile_of, at, hit)."""
    return np.empty(cells, np.int32), np.empty(cells, np.int32), np.empty(cells, np.bool_)
