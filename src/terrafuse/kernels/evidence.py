"""Evidence: what points say about one cell, as sums that add up exactly.

Heights are counted in ticks of 5 µm, so that a cell's n, Σz and Σz² are integers. Adding integers is associative and
commutative: however a log is cut into scans, robots and deltas, and in whatever order these meet, the sums are the same
to the last bit, at z = 1000 m as at 0. Σz² needs up to 94 bits and is kept as two words.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats

TICKS_PER_M = 200_000.0
"""Multiples of 1 cm and 1 mm, the units of LAS files, are whole ticks."""
TICK_M = 1.0 / TICKS_PER_M
MAX_Z_M = 10_737.0
"""|z| that fits 31 bits of ticks: every place on land, and all but the deepest trenches."""

Z_NONE_MIN = np.int32(2**31 - 1)
Z_NONE_MAX = np.int32(-(2**31))

EVIDENCE = np.dtype(
    [
        ("n", "<u4"),
        ("z_min", "<i4"),
        ("z_max", "<i4"),
        ("sq_hi", "<u4"),
        ("z_sum", "<i8"),
        ("sq_lo", "<u8"),
    ]
)
"""32 bytes, half a cache line: one line is touched for a point. `sq_hi`·2⁶⁴ + `sq_lo` = Σz²."""

TWO_64 = 2.0**64


def ticks(z_m: Array | float) -> Array:
    """Metres → whole ticks, rounded half to even."""
    return np.rint(np.asarray(z_m, np.float64) * TICKS_PER_M).astype(np.int64)


def mean_m(records: Array) -> Floats:
    """Mean height of each record in metres; NaN where n = 0. Field names as EVIDENCE."""
    n = records["n"].astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(records["z_sum"] / n * TICK_M)


def variance_m2(records: Array) -> Floats:
    """Variance (divided by n) of each record's heights in m²; NaN where n = 0."""
    n = records["n"].astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = records["z_sum"] / n
        mean_square = (records["sq_hi"] * TWO_64 + records["sq_lo"]) / n
    return np.asarray(np.maximum(mean_square - mean * mean, 0.0) * (TICK_M * TICK_M))


def consistent(records: Array) -> Array:
    """Which records n ≥ 1 heights can have: z_min ≤ mean ≤ z_max, Σ(z - mean)² ≥ 0 and Σ(z - z_min)(z_max - z) ≥ 0.

    The last two in floats, rounding granted. Field names as EVIDENCE.
    """
    n, low, high, total = (records[name].astype(np.int64) for name in ("n", "z_min", "z_max", "z_sum"))
    within = (n > 0) & (low <= high) & (n * low <= total) & (total <= n * high)
    square = records["sq_hi"] * TWO_64 + records["sq_lo"]
    return np.asarray(
        within & _spread(n.astype(float), low.astype(float), high.astype(float), total.astype(float), square)
    )


@njit(inline="always")
def is_consistent(record):
    """`consistent`, of one record."""
    n, low, high, total = np.int64(record.n), np.int64(record.z_min), np.int64(record.z_max), record.z_sum
    if n == 0 or low > high or n * low > total or total > n * high:
        return False
    square = np.float64(record.sq_hi) * TWO_64 + np.float64(record.sq_lo)
    count, least, most, mass = np.float64(n), np.float64(low), np.float64(high), np.float64(total)
    slack = 1e-12 * (abs(mass) * (abs(least) + abs(most)) + count * abs(least * most))
    bound = mass * (least + most) - count * least * most + slack
    return square * count >= mass * mass * (1 - 1e-12) and square * (1 - 1e-12) <= bound


@njit(inline="always")
def is_zero(record):
    own = record.n == 0 and record.z_min == 0 and record.z_max == 0
    return own and record.sq_hi == 0 and record.z_sum == 0 and record.sq_lo == 0


def _spread(n: Floats, low: Floats, high: Floats, total: Floats, square: Floats) -> Array:
    slack = 1e-12 * (abs(total) * (abs(low) + abs(high)) + n * abs(low * high))
    most = total * (low + high) - n * low * high + slack
    return np.asarray((square * n >= total * total * (1 - 1e-12)) & (square * (1 - 1e-12) <= most))


@njit(inline="always")
def hit(record, z):
    """One point of height z (ticks) into a record that starts at n = 0, z_min = +∞, z_max = -∞."""
    z64 = np.int64(z)
    record.n += np.uint32(1)
    record.z_min = min(record.z_min, z)
    record.z_max = max(record.z_max, z)
    record.z_sum += z64
    low = record.sq_lo + np.uint64(z64 * z64)
    record.sq_hi += np.uint32(low < record.sq_lo)
    record.sq_lo = low


@njit(inline="always")
def empty(record):
    """The state from which `hit` counts. A cell that nobody saw is `zero` instead."""
    record.n = np.uint32(0)
    record.z_min = Z_NONE_MIN
    record.z_max = Z_NONE_MAX
    record.sq_hi = np.uint32(0)
    record.z_sum = np.int64(0)
    record.sq_lo = np.uint64(0)


@njit(inline="always")
def zero(record):
    record.n = np.uint32(0)
    record.z_min = np.int32(0)
    record.z_max = np.int32(0)
    record.sq_hi = np.uint32(0)
    record.z_sum = np.int64(0)
    record.sq_lo = np.uint64(0)


@njit(inline="always")
def take(own, new):
    """own := new."""
    own.n = new.n
    own.z_min = new.z_min
    own.z_max = new.z_max
    own.sq_hi = new.sq_hi
    own.z_sum = new.z_sum
    own.sq_lo = new.sq_lo


@njit(inline="always")
def add(own, new):
    """own := own + new, exactly (Chan et al.'s pairwise merge, with the term between the means, in sums).

    A cell that has seen 2³² points by then has seen enough: it keeps what it knows.
    """
    if np.uint64(own.n) + np.uint64(new.n) > np.uint64(0xFFFFFFFF):
        return
    own.n += new.n
    own.z_min = min(own.z_min, new.z_min)
    own.z_max = max(own.z_max, new.z_max)
    own.z_sum += new.z_sum
    low = own.sq_lo + new.sq_lo
    own.sq_hi += new.sq_hi + np.uint32(low < own.sq_lo)
    own.sq_lo = low


@njit(inline="always")
def mean_ticks(record):
    return record.z_sum / record.n
