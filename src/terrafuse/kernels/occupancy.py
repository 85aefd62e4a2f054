"""An occupancy cell, and the adding that is all that ever happens to it.

Log-odds are whole ticks and are never clamped here, so that adding is exact, associative and commutative: the map is
the same in every bit however readings are cut into scans, robots and deltas.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats

TICKS_PER_NAT = 10_000
"""A tick of log-odds ln(p / (1 - p)) changes a probability by at most 0.000025."""

CELL = np.dtype([("sum", "<i8"), ("stamp", "<i8"), ("updates", "<u4"), ("revision", "<u4")])
"""Ticks of occupied over free, the stamp of the last update, how many readings said something of the cell (it stops at
MOST_UPDATES), and the robot's scan that changed it last. All zeros is the unknown cell; 24 bytes."""

READING = np.dtype([("ticks", "<i8"), ("updates", "<u4")])
"""What a scan says of a cell: ticks, and of how many readings."""

MOST_UPDATES = 2**32 - 1
MOST_TICKS = 745 * TICKS_PER_NAT
"""No reading says more, either way: the smallest float is e⁻⁷⁴⁴·⁴."""


def ticks(probability: float) -> int:
    """The log-odds of a probability of occupied, 0 < p < 1."""
    return round(math.log(probability / (1.0 - probability)) * TICKS_PER_NAT)


def probability(log_odds: Floats) -> Floats:
    """p of log-odds in nats."""
    return np.asarray(1.0 / (1.0 + np.exp(-log_odds)))


@njit(cache=True, nogil=True)
def read_rays(hit, hit_ticks, miss_ticks, readings):
    """What rays say of cells: hit (K,) bool → readings (K,), one of each."""
    for k in range(hit.shape[0]):
        readings[k].ticks = hit_ticks if hit[k] else miss_ticks
        readings[k].updates = 1


@njit(cache=True, nogil=True)
def take(cells, at, readings, stamp_ns, revision):
    """A robot's cells (T²,) CELL take in readings (K,) at distinct positions (K,), in place."""
    for k in range(at.shape[0]):
        cell, reading = cells[at[k]], readings[k]
        cell.sum += reading.ticks
        cell.updates = min(np.int64(cell.updates) + np.int64(reading.updates), MOST_UPDATES)
        cell.stamp = max(cell.stamp, stamp_ns)
        cell.revision = revision


def take_reference(cells: Array, at: Array, readings: Array, stamp_ns: int, revision: int) -> None:
    """What `take` must equal."""
    own = cells[at]
    own["sum"] += readings["ticks"]
    own["updates"] = _capped(own["updates"].astype(np.int64) + readings["updates"])
    own["stamp"] = np.maximum(own["stamp"], stamp_ns)
    own["revision"] = revision
    cells[at] = own


def fuse(older: Array, newer: Array) -> Array:
    """Evidence of two robots, (M,) each: sums and updates add, stamps take the newest."""
    out = np.empty_like(older)
    out["sum"] = older["sum"] + newer["sum"]
    out["updates"] = _capped(older["updates"].astype(np.int64) + newer["updates"])
    for field in ("stamp", "revision"):
        out[field] = np.maximum(older[field], newer[field])
    return out


def coarsen(cells: Array, factor: int) -> Array:
    """(H, W) cells → (H/k, W/k): the largest sum, where an unknown cell counts as 0; updates add."""
    height, width = cells.shape[0] // factor, cells.shape[1] // factor
    blocks = cells[: height * factor, : width * factor].reshape(height, factor, width, factor)
    out = np.empty((height, width), CELL)
    out["updates"] = _capped(blocks["updates"].sum(axis=(1, 3), dtype=np.int64))
    for field in ("sum", "stamp", "revision"):
        out[field] = blocks[field].max(axis=(1, 3))
    return out


def _capped(updates: Array) -> Array:
    return np.minimum(updates, MOST_UPDATES)
