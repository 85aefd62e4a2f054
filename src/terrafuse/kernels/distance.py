"""How far each cell is from the nearest marked one: the exact Euclidean distance transform, in whole numbers.

Felzenszwalb & Huttenlocher, "Distance transforms of sampled functions": along columns the distance is counted; along a
row the squared distance is the lower envelope of a parabola a column. Where one parabola gives way to the next is found
by whole division, as only whole places are asked.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array

FAR = 2**31 - 1
"""The squared distance where no cell is marked, and the largest that is told."""
NONE_ABOVE = 2**30
"""More cells than any column has."""


@njit(cache=True, nogil=True)
def along_columns(marked, steps):
    """Cells up or down to the nearest marked one, at least NONE_ABOVE in a column that has none."""
    height, width = marked.shape
    for i in range(width):
        steps[0, i] = 0 if marked[0, i] else NONE_ABOVE
    for j in range(1, height):
        for i in range(width):
            steps[j, i] = 0 if marked[j, i] else min(steps[j - 1, i] + 1, NONE_ABOVE)
    for j in range(height - 2, -1, -1):
        for i in range(width):
            steps[j, i] = min(steps[j, i], steps[j + 1, i] + 1)


@njit(cache=True, nogil=True)
def along_rows(steps):
    """Distances along columns become squared distances, in place."""
    height, width = steps.shape
    apex, low, first = np.empty(width, np.int64), np.empty(width, np.int64), np.empty(width, np.int64)
    for j in range(height):
        count = 0
        for i in range(width):
            if steps[j, i] >= NONE_ABOVE:
                continue
            square = np.int64(steps[j, i]) ** 2
            begin = np.int64(0)
            while count > 0:
                p = apex[count - 1]
                # x at which (x - p)² + low = (x - i)² + square: the later parabola is below from the next whole one on.
                begin = (square + i * i - low[count - 1] - p * p) // (2 * (i - p)) + 1
                if begin > first[count - 1]:
                    break
                count -= 1
                begin = np.int64(0)
            if begin < width:
                apex[count], low[count], first[count] = i, square, begin
                count += 1
        k = 0
        for i in range(width):
            while k + 1 < count and first[k + 1] <= i:
                k += 1
            steps[j, i] = min((i - apex[k]) ** 2 + low[k], FAR) if count else FAR


def squared_distance(marked: Array) -> Array:
    """(H, W) bool → (H, W) int32: squared distance to the nearest marked cell, centre to centre; FAR of none."""
    steps = np.empty(marked.shape, np.int32)
    if steps.size:
        along_columns(marked, steps)
        along_rows(steps)
    return steps


def squared_distance_reference(marked: Array) -> Array:
    """Every marked cell asked, for every cell."""
    j, i = np.indices(marked.shape)
    out = np.full(marked.shape, FAR, np.int64)
    for row, column in np.argwhere(marked):
        out = np.minimum(out, (j - row) ** 2 + (i - column) ** 2)
    return out
