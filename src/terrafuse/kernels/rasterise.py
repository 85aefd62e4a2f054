"""A scan → one evidence record for each cell that it hit (the scan-local patch of the *tiles* paper).

Only what the scan hit is touched. Points go in blocks: first transform, range gate and cell index, which vectorise;
then the update, whose cell is fetched ahead. An index grid over a window around the sensor gives each cell a slot in
a compact array of records that stays in the cache; points beyond the window wait for another pass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.kernels.evidence import EVIDENCE, MAX_Z_M, TICKS_PER_M, Z_NONE_MAX, Z_NONE_MIN, empty, hit, ticks
from terrafuse.kernels.grouping import table_size, tile_number
from terrafuse.kernels.memory import DISTANCE, prefetch
from terrafuse.lattice import MAX_CELL
from terrafuse.types import Array, Floats

BLOCK = 2048
WINDOW_BITS = 12
WINDOW = 1 << WINDOW_BITS
"""Cells along the index grid's side: 410 m at 0.1 m."""
PATCHWORK_BITS = 5
"""The grid is laid out in squares of 32×32 cells, one memory page each: a scan's cells lie on few pages."""
NOWHERE = WINDOW * WINDOW
"""The grid's extra cell, which takes the points that don't count."""

NOT_FINITE, TOO_NEAR, TOO_FAR, TOO_HIGH, OFF_LATTICE, LATER = range(6)
DROP_REASONS = (
    "not finite",
    "nearer than min_range_m",
    "beyond max_range_m",
    "height beyond ±10 km",
    "beyond the lattice",
)
COUNTERS = len(DROP_REASONS) + 1

TABLED = 1 << 14
"""Tiles that are looked up in a table of all; of more, in one of those that are hit."""


class Patchwork(NamedTuple):
    """The scratch of one robot's rasteriser, kept between scans: fresh memory costs more than the work.

    `records`, `tile_of` and `at` hold the last patch.
    """

    grid: Array
    """(NOWHERE + 1,) int32: `first_slot` (1 at first) + slot of each cell of the window; what is less is of an older
    scan, so that nothing need be cleared."""
    places: Array
    """(capacity,) int32: the grid index of each slot."""
    records: Array
    """(capacity,) EVIDENCE of each slot."""
    later: Array
    """(capacity,) int64: points beyond the window."""
    tile_of: Array
    """(capacity,) int32: the tile of each slot, counted in the order in which they are met."""
    at: Array
    """(capacity,) int32: the flat position of each slot in its tile."""

    @property
    def capacity(self) -> int:
        return len(self.places)


def new_patchwork(capacity: int, grid: Array | None = None) -> Patchwork:
    """Scratch for `capacity` points and cells; takes over the grid of a smaller one."""
    if grid is None:
        grid = np.zeros(NOWHERE + 1, np.int32)  # pages that no scan touches take no memory
    places, tile_of, at = (np.empty(capacity, np.int32) for _ in range(3))
    return Patchwork(grid, places, np.empty(capacity, EVIDENCE), np.empty(capacity, np.int64), tile_of, at)


@njit(inline="always")
def place_of(i, j):
    """Index in the grid of the cell (i, j) of the window."""
    inner = (1 << PATCHWORK_BITS) - 1
    return (
        ((j >> PATCHWORK_BITS) << (WINDOW_BITS + PATCHWORK_BITS))
        | ((i >> PATCHWORK_BITS) << (2 * PATCHWORK_BITS))
        | ((j & inner) << PATCHWORK_BITS)
        | (i & inner)
    )


@njit(inline="always")
def cell_at(place):
    """(i, j) in the window of a grid index: the inverse of `place_of`."""
    inner = (1 << PATCHWORK_BITS) - 1
    i = (((place >> (2 * PATCHWORK_BITS)) & ((WINDOW >> PATCHWORK_BITS) - 1)) << PATCHWORK_BITS) | (place & inner)
    j = ((place >> (WINDOW_BITS + PATCHWORK_BITS)) << PATCHWORK_BITS) | ((place >> PATCHWORK_BITS) & inner)
    return i, j


@njit(nogil=True)
def locate(x, y, z, m, T, cells_per_m, i0, j0, near2, far2, places, heights):
    """Transform m points (1-D arrays) and write each one's grid index and height in ticks. Returns how many count."""
    r00, r01, r02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    good = 0
    for k in range(m):
        px, py, pz = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
        i = np.floor((r00 * px + r01 * py + r02 * pz + t0) * cells_per_m) - i0
        j = np.floor((r10 * px + r11 * py + r12 * pz + t1) * cells_per_m) - j0
        up = r20 * px + r21 * py + r22 * pz + t2
        range2 = px * px + py * py + pz * pz
        ok = (
            (range2 >= near2)
            & (range2 <= far2)
            & (i >= 0.0)
            & (i < WINDOW)
            & (j >= 0.0)
            & (j < WINDOW)
            & (up >= -MAX_Z_M)
            & (up <= MAX_Z_M)
        )
        good += ok
        whole_i = np.int32(i if ok else 0.0)
        whole_j = np.int32(j if ok else 0.0)
        places[k] = place_of(whole_i, whole_j) if ok else NOWHERE
        heights[k] = np.int32(np.rint((up if ok else 0.0) * TICKS_PER_M))
    return good


@njit(inline="always")
def on_lattice(T, px, py, pz, cells_per_m):
    """Whether the lattice has a cell for a point of the sensor's frame."""
    east = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
    north = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
    return max(abs(east), abs(north)) * cells_per_m <= MAX_CELL


@njit(nogil=True)
def account(x, y, z, m, T, cells_per_m, near2, far2, first, places, dropped, later):
    """Count by reason why points of a block don't count; write the indices of those beyond the window to `later`."""
    for k in range(m):
        if places[k] != NOWHERE:
            continue
        px, py, pz = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
        range2 = px * px + py * py + pz * pz
        up = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if not np.isfinite(range2):
            dropped[NOT_FINITE] += 1
        elif range2 < near2:
            dropped[TOO_NEAR] += 1
        elif range2 > far2:
            dropped[TOO_FAR] += 1
        elif not (up >= -MAX_Z_M and up <= MAX_Z_M):
            dropped[TOO_HIGH] += 1
        elif not on_lattice(T, px, py, pz, cells_per_m):
            dropped[OFF_LATTICE] += 1
        else:
            later[dropped[LATER]] = first + k
            dropped[LATER] += 1


@njit(cache=True, nogil=True)
def rasterise(points, T, cells_per_m, i0, j0, near2, far2, grid, first_slot, places, records, dropped, later):
    """Rasterise (N, 3) points into the patchwork's window, whose first cell is (i0, j0). Returns the slots used.

    `grid` holds nothing that is `first_slot` or more.

    T: 4×4 float64 T_world_sensor; near2, far2: squared range gate in m². `dropped` (COUNTERS,) int64 is added to;
    `later` (N,) int64 receives the indices of points beyond the window, dropped[LATER] of them. `records` holds
    N + 1. The slot of NOWHERE, if any, is the caller's to ignore.
    """
    x = np.empty(BLOCK, points.dtype)
    y = np.empty(BLOCK, points.dtype)
    z = np.empty(BLOCK, points.dtype)
    where = np.zeros(BLOCK + DISTANCE, np.int32)
    heights = np.empty(BLOCK, np.int32)
    count = 0
    for first in range(0, points.shape[0], BLOCK):
        m = min(BLOCK, points.shape[0] - first)
        for k in range(m):
            x[k] = points[first + k, 0]
            y[k] = points[first + k, 1]
            z[k] = points[first + k, 2]
        good = locate(x, y, z, m, T, cells_per_m, i0, j0, near2, far2, where, heights)
        if good < m:
            account(x, y, z, m, T, cells_per_m, near2, far2, first, where, dropped, later)
        for k in range(m):
            prefetch(grid, where[k + DISTANCE])
            place = where[k]
            # No branch on "first hit of this cell": a third of a lidar's points are, at random.
            slot = grid[place] - first_slot
            new = slot < 0
            slot = count if new else slot
            grid[place] = slot + first_slot
            places[slot] = place
            empty(records[np.uint64(count)])  # whether or not it is this point's
            count += new
            hit(records[np.uint64(slot)], heights[k])
    return count


@njit(nogil=True)
def split(first, tile_cells):
    """For each column (or row) of a window that starts at this cell of a tile: the tile it is in, and where in it."""
    tile, within = np.empty(WINDOW, np.int32), np.empty(WINDOW, np.int32)
    t, w = 0, first
    for k in range(WINDOW):
        tile[k], within[k] = t, w
        w += 1
        if w == tile_cells:
            t, w = t + 1, 0
    return tile, within


@njit(cache=True, nogil=True)
def divide(places, records, count, i0, j0, tile_cells, keys, tile_of, at):
    """Say of each slot of a patchwork to which tile it belongs. Returns (tiles, slots); NOWHERE's slot is taken out.

    Writes the tiles hit to keys (T, 2) as (x, y), and for each slot the index of its tile there to `tile_of` and its
    flat position j·tile_cells + i in the tile to `at`.
    """
    tile0_x, tile0_y = i0 // tile_cells, j0 // tile_cells
    x, column = split(i0 - tile0_x * tile_cells, tile_cells)
    y, row = split(j0 - tile0_y * tile_cells, tile_cells)
    tiles = 0
    for k in range(count):
        if places[k] == NOWHERE:
            count -= 1
            places[k] = places[count]
            records[k] = records[count]
            break
    across = WINDOW // tile_cells + 2
    # Of tiles of few cells, a table of all that the window meets would cost more than the scan.
    small = across * across > TABLED
    seats = np.full(table_size(count) if small else across * across, -1, np.int32)
    for k in range(count):
        wi, wj = cell_at(places[k])
        tile_x, tile_y = tile0_x + x[wi], tile0_y + y[wj]
        if small:
            tile = tile_number(tile_x, tile_y, tiles, seats, keys)
        else:
            tile = seats[y[wj] * across + x[wi]]
            if tile < 0:
                tile = tiles
                seats[y[wj] * across + x[wi]] = tile
                keys[tile, 0], keys[tile, 1] = tile_x, tile_y
        tiles += tile == tiles
        tile_of[k] = tile
        at[k] = row[wj] * tile_cells + column[wi]
    return tiles, count


def rasterise_reference(
    points: Array, T: Floats, cells_per_m: float, near_m: float, far_m: float
) -> tuple[Array, Array]:
    """What `rasterise` and `divide` must equal: (K, 2) cells (i, j) in rising (j, i) order, and their (K,) EVIDENCE."""
    p = points.astype(np.float64)
    range2 = p[:, 0] * p[:, 0] + p[:, 1] * p[:, 1] + p[:, 2] * p[:, 2]
    world = [T[a, 0] * p[:, 0] + T[a, 1] * p[:, 1] + T[a, 2] * p[:, 2] + T[a, 3] for a in range(3)]
    ok = np.isfinite(range2) & (range2 >= near_m**2) & (range2 <= far_m**2) & (np.abs(world[2]) <= MAX_Z_M)
    ij = np.stack([np.floor(world[a][ok] * cells_per_m).astype(np.int64) for a in (1, 0)], axis=1)
    cells, cell_of = np.unique(ij, axis=0, return_inverse=True)
    z = ticks(world[2][ok])
    out = np.zeros(len(cells), EVIDENCE)
    out["z_min"], out["z_max"] = Z_NONE_MIN, Z_NONE_MAX
    np.add.at(out["n"], cell_of, 1)
    np.minimum.at(out["z_min"], cell_of, z)
    np.maximum.at(out["z_max"], cell_of, z)
    np.add.at(out["z_sum"], cell_of, z)
    squares = np.zeros(len(cells), object)  # Python's integers, which have no largest
    np.add.at(squares, cell_of, z.astype(object) ** 2)
    out["sq_hi"], out["sq_lo"] = squares >> 64, squares & (2**64 - 1)
    return cells[:, ::-1], out
