"""Which points of a scan are in a robot's way: a scan has thousands, a dozen times a second, and most are far away."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats


@njit(cache=True, nogil=True)
def in_the_way(points, matrix, reach, low, rising, high):
    """x, y (K, 2) of the points (N, 3), moved by a matrix (4, 4), that are nearer than `reach` along the ground, and
    between `low` + `rising` · distance and `high`."""
    out, count = np.empty((len(points), 2)), 0
    for k in range(len(points)):
        a, b, c = points[k, 0], points[k, 1], points[k, 2]
        z = matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2] * c + matrix[2, 3]
        if z <= low or z >= high:
            continue
        x = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2] * c + matrix[0, 3]
        y = matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2] * c + matrix[1, 3]
        distance = math.hypot(x, y)
        if distance < reach and z > low + rising * distance:
            out[count, 0], out[count, 1] = x, y
            count += 1
    return out[:count].copy()


def in_the_way_reference(points: Array, matrix: Floats, reach: float, low: float, rising: float, high: float) -> Floats:
    """What `in_the_way` must equal, but for rounding."""
    x, y, z = (points @ matrix[:3, :3].T + matrix[:3, 3]).T
    distance = np.hypot(x, y)
    found = (distance < reach) & (z > low + rising * distance) & (z < high)
    return np.column_stack([x[found], y[found]])
