"""Straight lines between centres of cells: which cells they cross, for how long, and whether they may replace a way.

Exact: where a line crosses borders is compared in whole numbers. Through a corner it steps diagonally; that cuts a
corner unless both cells beside the step can be entered.
"""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats


@njit(cache=True, nogil=True)
def cross(i0, j0, i1, j1, cells, lengths):
    """Write the cells (i, j) that a line crosses, in its order, and its length in each, in cells; returns how many.

    There is room for |i1 - i0| + |j1 - j0| + 1.
    """
    along_i, along_j = abs(i1 - i0), abs(j1 - j0)
    east, north = np.sign(i1 - i0), np.sign(j1 - j0)
    length = math.sqrt(float(along_i * along_i + along_j * along_j))
    i, j, count, last = i0, j0, 0, 0.0
    # The k-th border across i is crossed at (2k + 1)/(2·along_i) of the line: a and b are the next 2k + 1 of each axis.
    a, b = 1, 1
    while True:
        cells[count, 0], cells[count, 1] = i, j
        if i == i1 and j == j1:
            lengths[count] = (1.0 - last) * length
            return count + 1
        later = a * along_j - b * along_i
        in_i = along_i > 0 and (along_j == 0 or later <= 0)
        in_j = along_j > 0 and (along_i == 0 or later >= 0)
        now = a / (2.0 * along_i) if in_i else b / (2.0 * along_j)
        lengths[count] = (now - last) * length
        last = now
        count += 1
        if in_i:
            i += east
            a += 2
        if in_j:
            j += north
            b += 2


@njit(cache=True, nogil=True)
def price(costs, cells, lengths, count):
    """Cost of a line, -1.0 if it crosses or cuts the corner of a cell that can't be entered."""
    total = 0.0
    for k in range(count):
        i, j = cells[k]
        if costs[j, i] <= 0:
            return -1.0
        # Of a straight step, the cells beside it are its own two.
        if k > 0 and (costs[j, cells[k - 1, 0]] <= 0 or costs[cells[k - 1, 1], i] <= 0):
            return -1.0
        total += costs[j, i] * lengths[k]
    return total


@njit(cache=True, nogil=True)
def shortcuts(costs, way, slack):
    """Which cells of a way (N, 2) to keep, (K,) indices: between two of them a line costs no more than the way did.

    From each kept cell the line is lengthened along the way as long as that holds, to within `slack` of the cost.
    """
    room = costs.shape[0] + costs.shape[1]
    cells, lengths = np.empty((room, 2), np.int64), np.empty(room)
    kept = np.empty(way.shape[0], np.int64)
    kept[0] = 0
    count, walked = 1, 0.0
    for k in range(1, way.shape[0]):
        i, j = way[k - 1]
        length = math.sqrt(float((way[k, 0] - i) ** 2 + (way[k, 1] - j) ** 2))
        step = 0.5 * length * (float(costs[j, i]) + float(costs[way[k, 1], way[k, 0]]))
        first = way[kept[count - 1]]
        line = price(costs, cells, lengths, cross(first[0], first[1], way[k, 0], way[k, 1], cells, lengths))
        if line < 0.0 or line > (walked + step) * (1.0 + slack):
            kept[count] = k - 1
            count += 1
            walked = 0.0
        walked += step
    if way.shape[0] > 1:
        kept[count] = way.shape[0] - 1
        count += 1
    return kept[:count]


def crossed(corners: Array) -> tuple[Array, Floats]:
    """The cells (N, 2) that lines between corners (K, 2) cross, each step once, and the length in each, in cells."""
    cells, lengths = [corners[:1]], [np.zeros(1)]
    for (i0, j0), (i1, j1) in pairwise(corners.tolist()):
        room = abs(i1 - i0) + abs(j1 - j0) + 1
        some, parts = np.empty((room, 2), np.int64), np.empty(room)
        count = cross(i0, j0, i1, j1, some, parts)
        lengths[-1][-1] += parts[0]
        cells.append(some[1:count])
        lengths.append(parts[1:count])
    return np.concatenate(cells), np.concatenate(lengths)


def cross_reference(i0: int, j0: int, i1: int, j1: int) -> list[tuple[tuple[int, int], Fraction]]:
    """What `cross` must equal: the cells of the middles of the pieces between borders, and each one's share."""
    cuts = {Fraction(0), Fraction(1)}
    for span in (abs(i1 - i0), abs(j1 - j0)):
        cuts |= {Fraction(2 * k + 1, 2 * span) for k in range(span)}
    half = Fraction(1, 2)
    out = []
    for start, end in pairwise(sorted(cuts)):
        middle = (start + end) / 2
        cell = (math.floor(i0 + middle * (i1 - i0) + half), math.floor(j0 + middle * (j1 - j0) + half))
        out.append((cell, end - start))
    return out
