"""What this machine allows: the two stages that nobody can do without, each alone and with nothing else to do.

1. `locate`: transform the points, gate their range, compute their cells.
2. `scatter`: one 32-byte record a cell, at the true cells of the stream, in their order: count, sum, sum of squares,
   least and most, without a branch and with the cell fetched ahead.

In series they bound the points a second of any program that keeps such records.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.kernels.evidence import EVIDENCE, hit
from terrafuse.kernels.prefetch import DISTANCE, prefetch
from terrafuse.kernels.rasterise import BLOCK, locate
from terrafuse.types import Array, Scan


@njit(nogil=True)
def _locate_all(points, T, where, heights):
    x, y, z = np.empty(BLOCK, points.dtype), np.empty(BLOCK, points.dtype), np.empty(BLOCK, points.dtype)
    good = 0
    for first in range(0, points.shape[0], BLOCK):
        m = min(BLOCK, points.shape[0] - first)
        for k in range(m):
            x[k], y[k], z[k] = points[first + k, 0], points[first + k, 1], points[first + k, 2]
        good += locate(x, y, z, m, T, 10.0, -2048.0, -2048.0, 0.0, 1e16, where[first:], heights[first:])
    return good


@njit(nogil=True)
def _scatter_all(where, heights, m, records):
    for k in range(m):
        prefetch(records, where[k + DISTANCE])
        hit(records[np.uint64(where[k])], heights[k])


class Bound:
    """Prepared arrays for both stages."""

    def __init__(self, scans: list[Scan]) -> None:
        most = max(len(scan.points) for scan in scans)
        self._where, self._heights = np.zeros(most + DISTANCE, np.int32), np.empty(most, np.int32)
        self._records = np.zeros(4096 * 4096 + 1, EVIDENCE)
        self._located: list[tuple[Array, Array]] = []
        for scan in scans:
            self.locate(scan)
            self._located.append((self._where.copy(), self._heights.copy()))

    def locate(self, scan: Scan) -> None:
        _locate_all(scan.points, scan.T_world_sensor.matrix, self._where, self._heights)

    def scatter(self, index: int, scan: Scan) -> None:
        where, heights = self._located[index]
        _scatter_all(where, heights, len(scan.points), self._records)
