"""Cells of a lattice → cells of its tiles: the way from a flat list to a patch."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array


@njit(inline="always")
def tile_number(x, y, tiles, seats, keys):
    """The number of the tile (x, y) among the `tiles` that were met; `tiles` itself if it is new, and then it is noted.

    `seats` is an open hash table of tile numbers, -1 where free, a power of two long and never full.
    """
    mask = np.uint64(seats.shape[0] - 1)
    seat = (np.uint64(x) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(y) * np.uint64(0xC2B2AE3D27D4EB4F)) & mask
    while seats[seat] >= 0 and (keys[seats[seat], 0] != x or keys[seats[seat], 1] != y):
        seat = (seat + np.uint64(1)) & mask
    if seats[seat] < 0:
        seats[seat] = tiles
        keys[tiles, 0], keys[tiles, 1] = x, y
    return seats[seat]


@njit(nogil=True)
def table_size(tiles):
    """How long `seats` is for so many tiles."""
    size = 2
    while size <= 2 * tiles:
        size *= 2
    return size


@njit(inline="always")
def add_up(starts, tiles):
    """Cells of each tile in starts[1:] → where each tile's cells start; returns a copy to count on from."""
    starts[0] = 0
    for t in range(tiles):
        starts[t + 1] += starts[t]
    return starts[:tiles].copy()


@njit(cache=True, nogil=True)
def _group(i, j, side, seats, keys, starts, tile_of, at, order):
    """Returns the number of tiles. `starts` is all 0."""
    tiles = 0
    tile = -1
    low_i = low_j = np.int64(0)
    for k in range(i.shape[0]):
        in_i, in_j = i[k] - low_i, j[k] - low_j
        # Neighbours in a list mostly share a tile: then nothing is divided.
        if tile < 0 or in_i < 0 or in_i >= side or in_j < 0 or in_j >= side:
            x, y = i[k] // side, j[k] // side
            low_i, low_j = x * side, y * side
            in_i, in_j = i[k] - low_i, j[k] - low_j
            tile = tile_number(x, y, tiles, seats, keys)
            tiles += tile == tiles
        tile_of[k] = tile
        starts[tile + 1] += 1
        at[k] = in_j * side + in_i
    cursor = add_up(starts, tiles)
    for k in range(i.shape[0]):
        order[cursor[tile_of[k]]] = k
        cursor[tile_of[k]] += 1
    return tiles


def by_tile(i: Array, j: Array, tile_cells: int) -> tuple[Array, Array, Array, Array]:
    """Group cells (K,) int64 by tile: (keys (T, 2), starts (T + 1,), at (K,) int32, order (K,) int64).

    Tiles come in the order in which they are met, cells within one in the order given. Cells order[starts[t]:starts[t +
    1]] belong to tile keys[t] = (x, y), and lie there at the flat positions j·tile_cells + i of the same range of `at`.
    """
    count = len(i)
    most = min(count, _across(i, tile_cells) * _across(j, tile_cells))
    seats = np.full(table_size(most), -1, np.int32)
    keys, starts = np.empty((most, 2), np.int64), np.zeros(most + 1, np.int64)
    tile_of, order = np.empty(count, np.int64), np.empty(count, np.int64)
    at = np.empty(count, np.int32)
    tiles = _group(i, j, tile_cells, seats, keys, starts, tile_of, at, order)
    return keys[:tiles], starts[: tiles + 1], at[order], order


def _across(index: Array, side: int) -> int:
    """How many tiles lie from the first cell to the last."""
    return int(index.max()) // side - int(index.min()) // side + 1 if len(index) else 0


def by_tile_reference(i: Array, j: Array, tile_cells: int) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """What `by_tile` must equal: for each tile, in the order of its first cell, [(position, index of the cell)]."""
    out: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for k, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
        x, y = a // tile_cells, b // tile_cells
        out.setdefault((x, y), []).append(((b - y * tile_cells) * tile_cells + (a - x * tile_cells), k))
    return out
