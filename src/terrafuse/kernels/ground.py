"""Heights of a net of triangles. A simulator asks for a few at a time: of each robot, and of each body that moves."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats


@njit(cache=True, nogil=True)
def on_triangles(heights, west, south, step, x, y, z, east, north):
    """z, dz/dx and dz/dy (N,) at x, y (N,), NaN outside, of heights (R, C) [j, i] at the corners of squares that are
    cut from south-west to north-east."""
    rows, columns = heights.shape
    for k in range(len(x)):
        u, v = (x[k] - west) / step, (y[k] - south) / step
        if not (0 <= u <= columns - 1 and 0 <= v <= rows - 1):
            z[k] = east[k] = north[k] = np.nan
            continue
        i, j = min(int(u), columns - 2), min(int(v), rows - 2)
        f, g = u - i, v - j
        first, last = heights[j, i], heights[j + 1, i + 1]
        if f >= g:
            a, b = heights[j, i + 1] - first, last - heights[j, i + 1]
        else:
            a, b = last - heights[j + 1, i], heights[j + 1, i] - first
        z[k], east[k], north[k] = first + f * a + g * b, a / step, b / step


def on_triangles_reference(
    heights: Array, west: float, south: float, step: float, x: Floats, y: Floats
) -> tuple[Floats, Floats, Floats]:
    """What `on_triangles` must equal."""
    rows, columns = heights.shape
    u, v = (x - west) / step, (y - south) / step
    inside = (u >= 0) & (u <= columns - 1) & (v >= 0) & (v <= rows - 1)
    i, j = _square(u, columns), _square(v, rows)
    f, g = u - i, v - j
    first, last = heights[j, i], heights[j + 1, i + 1]
    corner = np.where(f >= g, heights[j, i + 1], heights[j + 1, i])
    east = np.where(f >= g, corner - first, last - corner)
    north = np.where(f >= g, last - corner, corner - first)
    out = first + f * east + g * north, east / step, north / step
    return tuple(np.where(inside, part, np.nan) for part in out)  # type: ignore[return-value]


def _square(place: Floats, corners: int) -> Array:
    # fmax and fmin, unlike clip, make a number of NaN.
    return np.asarray(np.fmin(np.fmax(place, 0), corners - 2).astype(np.int64))
