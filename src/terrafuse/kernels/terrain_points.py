"""A scan → the *patrol* paper's list of collision points, and their sums in each cell that they hit.

Points lie at (u, v) in their cell, in sides from its centre, and w metres above the sensor: small numbers, whose sums
of products lose nothing at UTM coordinates and at 1000 m. What is touched is what the scan touched; see `rasterise`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.kernels.evidence import MAX_Z_M
from terrafuse.kernels.memory import DISTANCE, add_four, prefetch
from terrafuse.kernels.rasterise import BLOCK, NOWHERE, WINDOW, account, place_of
from terrafuse.lattice import MAX_CELL
from terrafuse.types import Array, Floats

SUMS = np.dtype(
    [(name, "<f8") for name in ("n", "u", "v", "w", "uu", "uv", "vv", "uw", "vw", "low", "high")] + [("hit", "<u8")],
)
"""Of one cell's points: how many, Σu, Σv, Σw, the sums of products that a plane needs, the least and the greatest w, a
bit for each sub-cell hit."""


class PointList(NamedTuple):
    """Where the points of a scan lie, (N,) each: the grid index of the cell (NOWHERE: does not count), the number of
    the sub-cell in it, u, v and w."""

    places: Array
    parts: Array
    u: Floats
    v: Floats
    w: Floats


def new_points(capacity: int) -> PointList:
    # Longer than is used: what is fetched ahead is looked up beyond the last point.
    u, v, w = (np.empty(capacity) for _ in range(3))
    return PointList(np.zeros(capacity + DISTANCE, np.int32), np.empty(capacity, np.int32), u, v, w)


@njit(inline="always")
def part_of(share, across):
    """The sub-cell at this share of a side. What lies just below a whole number is 1.0 above the one before."""
    return min(np.int32(share * across), np.int32(across - 1))


@njit(nogil=True)
def locate_block(x, y, z, m, T, cells_per_m, i0, j0, near2, far2, across, places, parts, u, v, w):
    """m points (1-D arrays) → where they lie. Returns how many count."""
    r00, r01, r02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    good = 0
    for k in range(m):
        px, py, pz = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
        east = (r00 * px + r01 * py + r02 * pz + t0) * cells_per_m
        north = (r10 * px + r11 * py + r12 * pz + t1) * cells_per_m
        up = r20 * px + r21 * py + r22 * pz
        range2 = px * px + py * py + pz * pz
        i, j = np.floor(east), np.floor(north)
        a, b = i - i0, j - j0
        ok = (
            (range2 >= near2)
            & (range2 <= far2)
            & (a >= 0.0)
            & (a < WINDOW)
            & (b >= 0.0)
            & (b < WINDOW)
            & (abs(up + t2) <= MAX_Z_M)
            & (abs(east) <= MAX_CELL)
            & (abs(north) <= MAX_CELL)
        )
        good += ok
        whole_a, whole_b = np.int32(a if ok else 0.0), np.int32(b if ok else 0.0)
        places[k] = place_of(whole_a, whole_b) if ok else NOWHERE
        row, column = part_of(north - j, across), part_of(east - i, across)
        parts[k] = row * across + column
        u[k], v[k], w[k] = east - i - 0.5, north - j - 0.5, up
    return good


@njit(cache=True, nogil=True)
def locate(points, T, cells_per_m, i0, j0, near2, far2, across, places, parts, u, v, w, dropped, later):
    """(N, 3) points in the sensor's frame → where they lie in the window whose first cell is (i0, j0).

    T: 4×4 float64 T_world_sensor; near2, far2: squared range gate in m². A cell has across×across sub-cells. `dropped`
    (COUNTERS,) int64 is added to by reason, as in `rasterise`; `later` (N,) int64 receives the indices of the points
    beyond the window.
    """
    x, y, z = np.empty(BLOCK, points.dtype), np.empty(BLOCK, points.dtype), np.empty(BLOCK, points.dtype)
    for first in range(0, points.shape[0], BLOCK):
        m = min(BLOCK, points.shape[0] - first)
        for k in range(m):
            x[k] = points[first + k, 0]
            y[k] = points[first + k, 1]
            z[k] = points[first + k, 2]
        end = first + m
        where, part, a, b, c = places[first:end], parts[first:end], u[first:end], v[first:end], w[first:end]
        good = locate_block(x, y, z, m, T, cells_per_m, i0, j0, near2, far2, across, where, part, a, b, c)
        if good < m:
            account(x, y, z, m, T, cells_per_m, near2, far2, first, where, dropped, later)


@njit(cache=True, nogil=True)
def add_up(places, parts, u, v, w, n, grid, first_slot, cell_places, sums):
    """Add n points to the sums of their cells. Returns the number of cells.

    `grid` holds nothing that is `first_slot` or more; cell k gets `first_slot` + k there, its grid index in
    `cell_places` and its sums in `sums`.
    """
    count = 0
    for k in range(n):
        prefetch(grid, places[k + DISTANCE])
        place = places[k]
        if place == NOWHERE:
            continue
        slot = grid[place] - first_slot
        if slot < 0:  # in cells as large as this model's, few points are the first
            slot = count
            grid[place] = slot + first_slot
            cell_places[slot] = place
            clear(sums[np.uint64(slot)])
            count += 1
        hit(sums[np.uint64(slot)], parts[k], u[k], v[k], w[k])
    return count


@njit(inline="always")
def clear(s):
    s.n = s.u = s.v = s.w = s.uu = s.uv = s.vv = s.uw = s.vw = 0.0
    s.low, s.high = np.inf, -np.inf
    s.hit = np.uint64(0)


@njit(inline="always")
def hit(s, part, u, v, w):
    add_four(s, "n", 1.0, u, v, w)
    add_four(s, "uu", u * u, u * v, v * v, u * w)
    s.vw += v * w
    s.low = min(s.low, w)
    s.high = max(s.high, w)
    s.hit |= np.uint64(1) << np.uint64(part)


def locate_reference(
    points: Array, T: Floats, cells_per_m: float, near_m: float, far_m: float
) -> tuple[Array, Array, Floats, Floats, Floats]:
    """(i, j, u, v, w) of the points that count, in their order: what `locate` must equal."""
    p = points.astype(np.float64)
    range2 = p[:, 0] * p[:, 0] + p[:, 1] * p[:, 1] + p[:, 2] * p[:, 2]
    east, north = ((T[a, 0] * p[:, 0] + T[a, 1] * p[:, 1] + T[a, 2] * p[:, 2] + T[a, 3]) * cells_per_m for a in (0, 1))
    up = T[2, 0] * p[:, 0] + T[2, 1] * p[:, 1] + T[2, 2] * p[:, 2]
    ok = np.isfinite(range2) & (range2 >= near_m**2) & (range2 <= far_m**2) & (np.abs(up + T[2, 3]) <= MAX_Z_M)
    ok &= (np.abs(east) <= MAX_CELL) & (np.abs(north) <= MAX_CELL)
    east, north, up = east[ok], north[ok], up[ok]
    i, j = np.floor(east), np.floor(north)
    return i.astype(np.int64), j.astype(np.int64), east - i - 0.5, north - j - 0.5, up


def add_up_reference(i: Array, j: Array, u: Floats, v: Floats, w: Floats, across: int) -> tuple[Array, Array, Array]:
    """(i, j, sums) of the K cells that are hit, in rising (j, i) order: what `add_up` must equal."""
    west, south = i.min(initial=2**62), j.min(initial=2**62)
    width = i.max(initial=west) - west + 1
    cells, cell_of = np.unique((j - south) * width + (i - west), return_inverse=True)
    sums = np.zeros(len(cells), SUMS)
    ones = np.ones(len(u))
    terms = {"n": ones, "u": u, "v": v, "w": w, "uu": u * u, "uv": u * v, "vv": v * v, "uw": u * w, "vw": v * w}
    for name, term in terms.items():
        sums[name] = np.bincount(cell_of, term, len(cells))
    sums["low"], sums["high"] = np.inf, -np.inf
    np.minimum.at(sums["low"], cell_of, w)
    np.maximum.at(sums["high"], cell_of, w)
    row, column = (np.minimum((a + 0.5) * across, across - 1).astype(np.uint64) for a in (v, u))
    np.bitwise_or.at(sums["hit"], cell_of, np.uint64(1) << (row * np.uint64(across) + column))
    return cells % width + west, cells // width + south, sums
