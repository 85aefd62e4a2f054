"""Which cells lie in which polygons: even-odd filling at the cells' centres.

A crossing of a polygon's border with a row of centres turns all cells east of it from outside to inside or back.
Borders belong to the cells east and north of them, so that polygons that share one share no cell.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats


@njit(cache=True, nogil=True)
def burn(out: Floats, i0: int, j0: int, edges: Floats, first: Array, windows: Array, values: Floats) -> None:
    """Write the values of polygons, one after the other, into the cells of a tile.

    `out` (P, T, T) are its P properties, [j, i], whose first cell is (i0, j0); `edges` (E, 4) are (x, y) of the lower
    and of the upper end in cells, those of polygon q from `first[q]` to `first[q + 1]`; `windows` (Q, 4) hold
    (i0, j0, i1, j1) of the cells whose centres each polygon may reach; `values` (Q, P), NaN where it says nothing.
    """
    side = out.shape[1]
    turns = np.zeros((side, side + 1), np.bool_)
    for q in range(len(windows)):
        west, south = max(windows[q, 0] - i0, 0), max(windows[q, 1] - j0, 0)
        east, north = min(windows[q, 2] - i0, side), min(windows[q, 3] - j0, side)
        if west < east and south < north:
            for k in range(first[q], first[q + 1]):
                _cross(turns, edges[k], i0, j0, west, south, east, north)
            _fill(out, turns, values[q], west, south, east, north)


@njit(cache=True, nogil=True)
def _cross(turns: Array, edge: Floats, i0: int, j0: int, west: int, south: int, east: int, north: int) -> None:
    """Mark the first cell east of each crossing; what lies further west or east is marked at the window's side."""
    low = max(math.ceil(edge[1] - 0.5) - j0, south)
    high = min(math.ceil(edge[3] - 0.5) - j0, north)
    slope = (edge[2] - edge[0]) / (edge[3] - edge[1])
    for j in range(low, high):
        x = edge[0] + (j + j0 + 0.5 - edge[1]) * slope
        i = min(max(math.ceil(x - 0.5) - i0, west), east)
        turns[j, i] = not turns[j, i]


@njit(cache=True, nogil=True)
def _fill(out: Floats, turns: Array, values: Floats, west: int, south: int, east: int, north: int) -> None:
    """Follow each row from turn to turn, and forget the turns."""
    for j in range(south, north):
        inside = False
        for i in range(west, east):
            inside ^= turns[j, i]
            turns[j, i] = False
            if inside:
                for p in range(len(values)):
                    if not np.isnan(values[p]):
                        out[p, j, i] = values[p]
        turns[j, east] = False


def burn_reference(out: Floats, i0: int, j0: int, edges: Floats, first: Array, values: Floats) -> None:
    """The same: a cell is inside where an odd number of edges lies west of its centre or on it."""
    side = out.shape[1]
    y, x = np.mgrid[j0 : j0 + side, i0 : i0 + side] + 0.5
    for q in range(len(values)):
        inside = np.zeros((side, side), bool)
        for x0, y0, x1, y1 in edges[first[q] : first[q + 1]]:
            inside ^= (y0 <= y) & (y < y1) & (x0 + (y - y0) * ((x1 - x0) / (y1 - y0)) <= x)
        for p in np.flatnonzero(~np.isnan(values[q])):
            out[p][inside] = values[q, p]
