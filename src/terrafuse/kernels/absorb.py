"""The *tiles* paper's merge logic (its Fig. 4): a cell takes in another's evidence.

One rule serves twice: a robot's own cell takes in a scan's patch, and the global cell takes in the next robot's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from terrafuse.kernels.evidence import (
    EVIDENCE,
    TICKS_PER_M,
    TWO_64,
    add,
    is_consistent,
    is_zero,
    mean_m,
    mean_ticks,
    take,
    variance_m2,
    zero,
)
from terrafuse.kernels.memory import DISTANCE, prefetch_at, record_at
from terrafuse.types import Array

_EVIDENCE = [(name, EVIDENCE[name].str) for name in EVIDENCE.names or ()]

_SURFACE = [*_EVIDENCE, ("stamp", "<i8"), ("revision", "<u4"), ("changes", "<u4"), ("merges", "<u4")]


def _layout(fields: list[tuple[str, str]], offsets: list[int], itemsize: int) -> np.dtype[Any]:
    names, formats = ([field[k] for field in fields] for k in (0, 1))
    layout: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": itemsize}
    dtype: np.dtype[Any] = np.dtype(layout)
    return dtype


SURFACE_BYTES, EVIDENCE_BYTES = 64, EVIDENCE.itemsize
SURFACE = _layout(_SURFACE, [np.dtype(_SURFACE[:k]).itemsize for k in range(len(_SURFACE))], SURFACE_BYTES)
"""What a scan touches of a cell, padded to a cache line: its evidence, when it was last updated and by which revision,
how often its surface changed and how often it was merged."""

CELL = np.dtype([*_SURFACE, *((f"ground_{name}", form) for name, form in _EVIDENCE)])
"""An elevation cell, 84 bytes: its surface, and the evidence of the flat surface that something now covers
(`ground_n` = 0: none). All zeros is the unknown cell."""

GROUND_OF_CELL = _layout(
    _EVIDENCE, [np.dtype(_SURFACE).itemsize + np.dtype(_EVIDENCE[:k]).itemsize for k in range(6)], CELL.itemsize
)
"""CELL seen as the EVIDENCE of its ground."""


class Rules(NamedTuple):
    """The thresholds in the kernels' units."""

    static: bool
    flat_tolerance: float
    """ticks"""
    variance_threshold: float
    """ticks²"""
    flat_range: float
    """ticks; a variance is at most a quarter of the range's square, so that a smaller range is flat at a glance"""


def rules(static: bool, flat_tolerance_m: float, variance_threshold_m2: float) -> Rules:
    variance = variance_threshold_m2 * TICKS_PER_M**2
    # A millionth less, so that rounding in the variance itself can't decide otherwise.
    return Rules(static, flat_tolerance_m * TICKS_PER_M, variance, 2 * (1 - 1e-6) * variance**0.5)


@njit(inline="always")
def is_vertical(record, rules):
    """n > 2 and a variance over the threshold; times n², so that nothing is divided."""
    if np.int64(record.z_max) - np.int64(record.z_min) <= rules.flat_range:
        return False
    n, total = np.float64(record.n), np.float64(record.z_sum)
    square = record.sq_hi * TWO_64 + record.sq_lo
    return record.n > 2 and square * n - total * total > rules.variance_threshold * (n * n)


@njit(inline="always")
def agree(a, b, rules):
    """Whether two surfaces' means are within the tolerance of each other; times both counts."""
    n_a, n_b = np.float64(a.n), np.float64(b.n)
    return abs(a.z_sum * n_b - b.z_sum * n_a) <= rules.flat_tolerance * (n_a * n_b)


@njit(inline="always")
def cover(own, ground):
    """Cache the flat surface that is about to be covered; of two, the lower one is the ground."""
    if ground.n == 0 or mean_ticks(own) < mean_ticks(ground):
        take(ground, own)


@njit(inline="always")
def absorb(own, ground, new, rules):
    """Take `new` into `own`; both are known. `ground` is own's cached ground. Returns 1 where the surface changed."""
    if rules.static:
        add(own, new)
        return 0
    own_vertical, new_vertical = is_vertical(own, rules), is_vertical(new, rules)
    if own_vertical == new_vertical and (own_vertical or agree(own, new, rules)):
        add(own, new)
        return 0
    if not new_vertical and ground.n > 0 and agree(ground, new, rules):
        take(own, ground)
        zero(ground)
        add(own, new)
        return 1
    if not own_vertical:
        cover(own, ground)
    take(own, new)
    return 1


_SURFACES, _GROUNDS = np.empty(0, SURFACE), np.empty(0, EVIDENCE)
_POSITIONS = np.empty(0, np.dtype([("at", "<i4")]))

STATE = np.dtype([("surface", "<i8"), ("ground", "<i8"), ("changed", "<i8"), ("count", "<i8"), ("reported", "<i8")])
"""A tile as `merge` sees it: the addresses of its (T²,) SURFACE, (T²,) EVIDENCE and (T² + 1,) int32 list of positions
that changed after revision `reported`, and how many of those there are."""


@njit(cache=True, nogil=True)
def merge(tiles, tile_of, at, patch, stamp, revision, rules):
    """A robot's tiles ← a scan's patch.

    tiles (T,) STATE; patch (K,) EVIDENCE, of which record k belongs to position at[k] of tile tile_of[k], each once.
    """
    last = at.shape[0] - 1
    for k in range(at.shape[0]):
        ahead = min(k + DISTANCE, last)
        prefetch_at(tiles[tile_of[ahead]].surface + np.int64(at[ahead]) * SURFACE_BYTES)
        tile, place, new = tiles[tile_of[k]], np.int64(at[k]), patch[k]
        own = record_at(_SURFACES, tile.surface + place * SURFACE_BYTES)
        if own.n == 0:
            take(own, new)
        else:
            own.changes += np.uint32(absorb(own, record_at(_GROUNDS, tile.ground + place * EVIDENCE_BYTES), new, rules))
        record_at(_POSITIONS, tile.changed + 4 * tile.count).at = at[k]
        tile.count += own.revision <= tile.reported
        own.merges += np.uint32(1)
        own.stamp = max(own.stamp, stamp)
        own.revision = np.uint32(revision)


@njit(inline="always")
def copy_surface(to, of):
    take(to, of)
    to.stamp = of.stamp
    to.revision = of.revision
    to.changes = of.changes
    to.merges = of.merges


@njit(cache=True, nogil=True)
def sound(cells, grounds):
    """Whether points can have made these (K,) CELLs; grounds is the same memory as GROUND_OF_CELL."""
    for k in range(cells.shape[0]):
        if cells[k].changes >= cells[k].merges or not is_consistent(cells[k]):
            return False
        if not (is_zero(grounds[k]) or is_consistent(grounds[k])):
            return False
    return True


@njit(cache=True, nogil=True)
def read(surface, ground, at, cells, cell_grounds):
    """(K,) CELL := what a tile holds at these positions; cell_grounds is the same memory as GROUND_OF_CELL."""
    for k in range(at.shape[0]):
        copy_surface(cells[k], surface[at[k]])
        take(cell_grounds[k], ground[at[k]])


@njit(cache=True, nogil=True)
def write(surface, ground, at, cells, cell_grounds):
    """The inverse of `read`."""
    for k in range(at.shape[0]):
        copy_surface(surface[at[k]], cells[k])
        take(ground[at[k]], cell_grounds[k])


@njit(cache=True, nogil=True)
def fuse(own_cells, own_grounds, new_cells, new_grounds, rules):
    """The next step of the fold, in place: own_cells[k] takes new_cells[k] in. All (M,), views of CELL."""
    for k in range(own_cells.shape[0]):
        own, ground, new, new_ground = own_cells[k], own_grounds[k], new_cells[k], new_grounds[k]
        if new.n == 0:
            continue
        if own.n == 0:
            take(own, new)
            take(ground, new_ground)
        else:
            own.changes += np.uint32(absorb(own, ground, new, rules))
            if new_ground.n > 0 and (ground.n == 0 or mean_ticks(new_ground) < mean_ticks(ground)):
                take(ground, new_ground)
        own.changes += new.changes
        own.merges += new.merges
        own.stamp = max(own.stamp, new.stamp)
        own.revision = max(own.revision, new.revision)


@njit(cache=True, nogil=True)
def coarsen(cells, factor, out):
    """k×k cells → one: cells (H, W) CELL, out (H/k, W/k) CELL of zeros. Sums add, stamps take the newest."""
    for j in range(out.shape[0] * factor):
        for i in range(out.shape[1] * factor):
            new, own = cells[j, i], out[j // factor, i // factor]
            if new.n == 0:
                continue
            if own.n == 0:
                take(own, new)
            else:
                add(own, new)
            own.changes += new.changes
            own.merges += new.merges
            own.stamp = max(own.stamp, new.stamp)
            own.revision = max(own.revision, new.revision)


def vertical(records: Array, limits: Rules) -> Array:
    """Which records are vertical: n > 2 and a variance over the threshold."""
    threshold_m2 = limits.variance_threshold / TICKS_PER_M**2
    return np.asarray((records["n"] > 2) & (np.nan_to_num(variance_m2(records)) > threshold_m2))


def absorb_reference(own: Array, ground: Array, new: Array, limits: Rules) -> tuple[Array, Array, bool]:
    """The table of the merge, row by row, on single EVIDENCE records: (own, ground) after, and whether it changed."""

    def joined(a: Array, b: Array) -> Array:
        square = sum((int(r["sq_hi"]) << 64) + int(r["sq_lo"]) for r in (a, b))
        low, high = min(a["z_min"], b["z_min"]), max(a["z_max"], b["z_max"])
        total = a["z_sum"] + b["z_sum"]
        return np.array((a["n"] + b["n"], low, high, square >> 64, total, square & (2**64 - 1)), EVIDENCE)

    def agree(a: Array, b: Array) -> bool:
        return bool(abs(mean_m(a) - mean_m(b)) <= limits.flat_tolerance / TICKS_PER_M)

    states = (bool(vertical(own, limits)), bool(vertical(new, limits)))
    if limits.static or states == (True, True) or (states == (False, False) and agree(own, new)):
        return joined(own, new), ground, False
    if not states[1] and ground["n"] and agree(ground, new):
        return joined(ground, new), np.zeros((), EVIDENCE), True
    if not states[0] and (not ground["n"] or mean_m(own) < mean_m(ground)):
        ground = own
    return new, ground, True
