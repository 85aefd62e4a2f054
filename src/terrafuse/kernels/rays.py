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


CROSSED, HIT = np.uint8(1), np.uint8(2)


@njit(cache=True, nogil=True)
def trace(ends, marks, cells_per_m, i0, j0, width, seen, places):
    """Hits first, then what the segments (K, 4) cross: each cell of the window once.

    A segment with marks[k] hits the cell that holds its end. `seen`, a byte a cell of the window, is all 0; afterwards
    it has HIT (with CROSSED or without) or CROSSED. `places`, a power of two long, gets the window indices
    (j - j0)·width + (i - i0) of these cells, if it is longer than they are many; else it is of no use.
    Returns (how many are hits, how many in all).
    """
    mask = np.uint64(places.shape[0] - 1)
    count = np.uint64(0)
    for k in range(ends.shape[0]):
        if marks[k]:
            i = (subcell(ends[k, 2], cells_per_m) >> SUBCELL_BITS) - i0
            j = (subcell(ends[k, 3], cells_per_m) >> SUBCELL_BITS) - j0
            places[count & mask] = j * width + i
            count += np.uint64(seen[j * width + i] == 0)
            seen[j * width + i] = HIT
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
            before = seen[place]
            places[count & mask] = place
            count += np.uint64(before == 0)
            seen[place] = before | CROSSED
            if left <= 0:
                break
            in_x, in_y = np.int64(later <= 0), np.int64(later >= 0)
            place = np.uint64(np.int64(place) + in_x * east + in_y * north)
            later += in_x * over_x - in_y * over_y
            left -= in_x + in_y
    return np.int64(hits), np.int64(count)


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
    """What `traced.Tracer` must equal: (cells that are hit, cells that are crossed and not hit)."""
    hits: set[tuple[int, int]] = set()
    crossed: set[tuple[int, int]] = set()
    for segment, mark in zip(ends.tolist(), marks.tolist(), strict=True):
        x0, y0, x1, y1 = (Fraction(floor(c * cells_per_m * SUBCELLS), SUBCELLS) for c in segment)
        crossed |= crossed_reference(x0, y0, x1, y1)
        if mark:
            hits.add((floor(x1), floor(y1)))
    return hits, crossed - hits
