"""A scan's beams as segments on the ground plane, within the sensor's range and the map's slice of height.

A beam that goes beyond the range or leaves the slice still tells of the way up to there: it is cut and marks nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.lattice import MAX_CELL

NO_PLACE, TOO_NEAR, TOO_FAR, TOO_HIGH, BAD_MISS, ASTRAY = range(6)
REASONS = (
    "not finite or beyond the lattice",
    "nearer than min_range_m",
    "at or beyond max_range_m: cleared up to it",
    "outside min_z_m to max_z_m: cleared within",
    "miss not finite, beyond the lattice or nearer than min_range_m",
    "start of beam far from the others'",
)

FULL_RANGE = 1.0 - 1e-6
"""A reading of this part of the maximum is at the maximum: coordinates in float32 make a range that much shorter."""


@njit(inline="always")
def row(points, k):
    return np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])


@njit(inline="always")
def turned(T, axis, x, y, z):
    return T[axis, 0] * x + T[axis, 1] * y + T[axis, 2] * z


@njit(inline="always")
def inside(up, low, high):
    """(first, last) part of a beam that rises by `up` which lies between two heights; first > last if none does."""
    if up > 0.0:
        return max(0.0, low / up), min(1.0, high / up)
    if up < 0.0:
        return max(0.0, high / up), min(1.0, low / up)
    return 0.0, 1.0 if low <= 0.0 <= high else -1.0


@njit(cache=True, nogil=True)
def segments(points, misses, origins, T, near, far, low, high, cells_per_m, most_away, ends, marks, dropped):
    """Beams → segments x0 y0 x1 y1 in world metres to ends (N + M, 4), and to marks (N + M,) whether each hits its end.

    Returns how many. points (N, 3), misses (M, 3) and origins (N + M or 1, 3) are in the sensor's frame, T is
    T_world_sensor. near, far: the range in m; low, high: heights above the beam's own start, in the world, between
    which it counts; most_away: cells that a beam may start from where the first one does. `dropped` (6,) is added to.
    """
    count = 0
    first_x = first_y = np.nan
    for k in range(points.shape[0] + misses.shape[0]):
        real = k < points.shape[0]
        ex, ey, ez = row(points, k) if real else row(misses, k - points.shape[0])
        ox, oy, oz = row(origins, k if origins.shape[0] > 1 else 0)
        length = np.sqrt((ex - ox) ** 2 + (ey - oy) ** 2 + (ez - oz) ** 2)
        x0, y0 = turned(T, 0, ox, oy, oz) + T[0, 3], turned(T, 1, ox, oy, oz) + T[1, 3]
        x1, y1 = turned(T, 0, ex, ey, ez) + T[0, 3], turned(T, 1, ex, ey, ez) + T[1, 3]
        if not (np.isfinite(length) and max(abs(x1), abs(y1)) * cells_per_m <= MAX_CELL):
            dropped[NO_PLACE if real else BAD_MISS] += 1
            continue
        if length < near or length == 0.0:
            dropped[TOO_NEAR if real else BAD_MISS] += 1
            continue
        if np.isnan(first_x) and max(abs(x0), abs(y0)) * cells_per_m <= MAX_CELL:
            first_x, first_y = x0, y0
        if not max(abs(x0 - first_x), abs(y0 - first_y)) * cells_per_m <= most_away:
            dropped[ASTRAY] += 1
            continue
        up = turned(T, 2, ex - ox, ey - oy, ez - oz)
        first, last = inside(up, low, high)
        if length >= far * FULL_RANGE:
            dropped[TOO_FAR] += real
            last = min(last, far / length)
            real = False
        elif real and not low <= up <= high:
            dropped[TOO_HIGH] += 1
            real = False
        if first > last:
            continue
        ends[count, 0], ends[count, 1] = x0 + first * (x1 - x0), y0 + first * (y1 - y0)
        ends[count, 2] = x1 if last == 1.0 else x0 + last * (x1 - x0)
        ends[count, 3] = y1 if last == 1.0 else y0 + last * (y1 - y0)
        marks[count] = real
        count += 1
    return count
