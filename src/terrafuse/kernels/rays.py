"""Where a ray goes: the cells that a segment crosses, exactly, and each at most once a scan.

Amanatides & Woo, "A fast voxel traversal algorithm for ray tracing", in whole numbers: ends are rounded down to 1/65536
of a cell, and which border comes next is the sign of an integer, so that nothing drifts, no ray misses its end, and
every machine gives the same cells.

A segment crosses a cell if it has a part of some length in it; borders belong to the cell east or north of them.
Through a corner it goes from cell to cell diagonally, without the two beside it. A hit marks the cell that holds its
end.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.types import Array

SUBCELL_BITS = 16
SUBCELLS = 1 << SUBCELL_BITS
"""Ends of rays count in these parts of a cell: 1.5 µm of 0.1 m."""

MAX_RAY_CELLS = 4096
"""No ray is longer: 410 m at 0.1 m. With MAX_SPREAD_CELLS it bounds time and memory, whatever a scan says."""
MAX_SPREAD_CELLS = 1024
"""No ray of a scan starts further from where its first one does, east or north."""


@njit(inline="always")
def subcell(coordinate, cells_per_m):
    return np.int64(np.floor(coordinate * cells_per_m * SUBCELLS))


@njit(inline="always")
def borders(start, end):
    """(first cell, last cell, distance to the first border) of a segment along one axis, all from parts of a cell.

    A segment that goes down from a border, or ends on one coming up, has no length in the cell that the border is of.
    """
    if end < start:
        first = (start - 1) >> SUBCELL_BITS
        return first, end >> SUBCELL_BITS, start - (first << SUBCELL_BITS)
    first = start >> SUBCELL_BITS
    return first, max(first, (end - 1) >> SUBCELL_BITS), ((first + 1) << SUBCELL_BITS) - start


@njit(cache=True, nogil=True)
def extent(ends, cells_per_m):
    """The smallest window of cells that holds segments (K, 4) as x0 y0 x1 y1 in metres, K ≥ 1.

    Returns (i0, j0, width, height, at most so many cells are crossed or marked).
    """
    i0 = j0 = np.int64(2) ** 62
    i1 = j1 = -i0
    cells = 0
    for k in range(ends.shape[0]):
        x0, x1 = subcell(ends[k, 0], cells_per_m), subcell(ends[k, 2], cells_per_m)
        y0, y1 = subcell(ends[k, 1], cells_per_m), subcell(ends[k, 3], cells_per_m)
        # The part before a border lies in the cell before it.
        west, east = (min(x0, x1) - 1) >> SUBCELL_BITS, max(x0, x1) >> SUBCELL_BITS
        south, north = (min(y0, y1) - 1) >> SUBCELL_BITS, max(y0, y1) >> SUBCELL_BITS
        i0, i1, j0, j1 = min(i0, west), max(i1, east), min(j0, south), max(j1, north)
        cells += east - west + north - south + 2
    width, height = i1 - i0 + 1, j1 - j0 + 1
    return i0, j0, width, height, min(cells, width * height)


@njit(cache=True, nogil=True)
def trace(ends, marks, cells_per_m, i0, j0, width, seen, places):
    """Hits first, then what the segments (K, 4) cross: each cell of the window once.

    Writes window indices (j - j0)·width + (i - i0) to `places`, which has room for one more than there can be; returns
    (how many are hits, how many in all). A segment with marks[k] hits the cell that holds its end. `seen`, a byte a
    cell, is all 0, and 1 afterwards where `places` says.
    """
    count = 0
    for k in range(ends.shape[0]):
        if marks[k]:
            i = (subcell(ends[k, 2], cells_per_m) >> SUBCELL_BITS) - i0
            j = (subcell(ends[k, 3], cells_per_m) >> SUBCELL_BITS) - j0
            places[count] = j * width + i
            count += seen[j * width + i] == 0
            seen[j * width + i] = 1
    hits = count
    for k in range(ends.shape[0]):
        x0, x1 = subcell(ends[k, 0], cells_per_m), subcell(ends[k, 2], cells_per_m)
        y0, y1 = subcell(ends[k, 1], cells_per_m), subcell(ends[k, 3], cells_per_m)
        i, last_i, to_x = borders(x0, x1)
        j, last_j, to_y = borders(y0, y1)
        along_x, along_y = abs(x1 - x0), abs(y1 - y0)
        left = abs(last_i - i) + abs(last_j - j)
        east = np.int64(-1 if x1 < x0 else 1)
        north = np.int64(-width if y1 < y0 else width)
        # Whether the next border across x is nearer (< 0) than the next across y, or both are a corner (0).
        later = to_x * along_y - to_y * along_x
        over_x, over_y = along_y << SUBCELL_BITS, along_x << SUBCELL_BITS
        place = np.uint64((j - j0) * width + (i - i0))
        while True:
            # Without a branch on "seen": about half of the cells are, in no order that a processor could guess.
            places[count] = place
            count += seen[place] == 0
            seen[place] = 1
            if left <= 0:
                break
            in_x, in_y = np.int64(later <= 0), np.int64(later >= 0)
            place = np.uint64(np.int64(place) + in_x * east + in_y * north)
            later += in_x * over_x - in_y * over_y
            left -= in_x + in_y
    return hits, count


@njit(cache=True, nogil=True)
def group(places, hits, i0, j0, width, side, seen, seats, across, keys, starts, tile_of, at, hit):
    """Window indices (K,) → flat positions in tiles, by tile: writes keys, starts, at and hit as `Traced` has them.

    `seats` (across · …), all -1, covers the tiles that the window meets. `places` are used up, `seen` is all 0 again.
    Returns the number of tiles.
    """
    per_column = 1.0 / width
    tile0_x, tile0_y = i0 // side, j0 // side
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
            seat = (y - tile0_y) * across + (x - tile0_x)
            if seats[seat] < 0:
                seats[seat] = tiles
                keys[tiles, 0], keys[tiles, 1] = x, y
                starts[tiles + 1] = 0
                tiles += 1
            tile = seats[seat]
        tile_of[k] = tile
        starts[tile + 1] += 1
        places[k] = in_j * side + in_i
    starts[0] = 0
    for t in range(tiles):
        starts[t + 1] += starts[t]
    cursor = starts[:tiles].copy()
    for k in range(places.shape[0]):
        to = cursor[tile_of[k]]
        cursor[tile_of[k]] += 1
        at[to] = places[k]
        hit[to] = k < hits
    return tiles


class Traced(NamedTuple):
    """The cells of a scan's rays, each once, by tile: at[starts[t]:starts[t + 1]] lie in tile keys[t] = (x, y)."""

    keys: Array
    """(T, 2) int64."""
    starts: Array
    """(T + 1,) int64."""
    at: Array
    """(K,) int32 flat positions, j·tile_cells + i."""
    hit: Array
    """(K,) bool: whether a marked segment ends there; the other cells are crossed only."""


class Tracer:
    """The rays of one robot's scans; keeps the scratch between them: fresh memory costs more than the work."""

    def __init__(self, cells_per_m: float, tile_cells: int) -> None:
        self._cells_per_m, self._side = cells_per_m, tile_cells
        self._seen = np.zeros(1 << 16, np.uint8)
        self._places = np.empty(1 << 12, np.int32)
        self._grouped = _room(1 << 12)

    def __call__(self, ends: Array, marks: Array) -> Traced:
        """Segments (K, 4) x0 y0 x1 y1 in metres, marks (K,) bool: those that hit the cell that holds their end.

        Segments keep to MAX_RAY_CELLS and MAX_SPREAD_CELLS. What it returns is scratch, and holds until the next scan.
        """
        if not len(ends):
            return Traced(np.empty((0, 2), np.int64), np.zeros(1, np.int64), np.empty(0, np.int32), np.empty(0, bool))
        i0, j0, width, height, most = extent(ends, self._cells_per_m)
        if len(self._seen) < width * height:
            self._seen = np.zeros(1 << (width * height - 1).bit_length(), np.uint8)
        if len(self._places) < most + 1:
            self._places = np.empty(1 << int(most).bit_length(), np.int32)
        hits, count = trace(ends, marks, self._cells_per_m, i0, j0, width, self._seen, self._places)
        return self._by_tile(count, hits, (i0, j0, width, height))

    def _by_tile(self, count: int, hits: int, window: tuple[int, int, int, int]) -> Traced:
        i0, j0, width, height = window
        side = self._side
        if len(self._grouped[0]) < count:
            self._grouped = _room(1 << (count - 1).bit_length())
        tile_of, at, hit = self._grouped
        across, up = ((first + cells - 1) // side - first // side + 1 for first, cells in ((i0, width), (j0, height)))
        seats, keys = np.full(across * up, -1, np.int32), np.empty((across * up, 2), np.int64)
        starts = np.empty(across * up + 1, np.int64)
        tiles = group(
            self._places[:count], hits, i0, j0, width, side, self._seen, seats, across, keys, starts, tile_of, at, hit
        )
        return Traced(keys[:tiles], starts[: tiles + 1], at[:count], hit[:count])


def _room(cells: int) -> tuple[Array, Array, Array]:
    """(tile_of, at, hit)."""
    return np.empty(cells, np.int32), np.empty(cells, np.int32), np.empty(cells, np.bool_)


def crossed_reference(x0: Fraction, y0: Fraction, x1: Fraction, y1: Fraction) -> set[tuple[int, int]]:
    """The cells that a segment crosses, its ends in cells: those of the middles of its pieces between borders."""
    cuts = {Fraction(0), Fraction(1)}
    for start, end in ((x0, x1), (y0, y1)):
        if start != end:
            low, high = sorted((start, end))
            cuts |= {(border - start) / (end - start) for border in range(ceil(low), floor(high) + 1)}
    ordered = sorted(cuts)
    middles = [(a + b) / 2 for a, b in pairwise(ordered)]
    return {(floor(x0 + t * (x1 - x0)), floor(y0 + t * (y1 - y0))) for t in middles}


def trace_reference(ends: Array, marks: Array, cells_per_m: float) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """What `Tracer` must equal: (cells that are hit, cells that are crossed and not hit)."""
    hits: set[tuple[int, int]] = set()
    crossed: set[tuple[int, int]] = set()
    for segment, mark in zip(ends.tolist(), marks.tolist(), strict=True):
        x0, y0, x1, y1 = (Fraction(floor(c * cells_per_m * SUBCELLS), SUBCELLS) for c in segment)
        crossed |= crossed_reference(x0, y0, x1, y1)
        if mark:
            hits.add((floor(x1), floor(y1)))
    return hits, crossed - hits
