"""What this machine allows: the two stages that nobody can do without, each alone and as lean as they can be.

1. `locate`: transform float32 points, compute their cells. No gate, no window, nothing dropped.
2. `scatter`: one 32-byte float record a cell (count, sum, sum of squares, least, most), at the true cells of the stream
   in their order, without a branch and with the cell fetched ahead.

In series they bound the points a second of any program that keeps such records. None of the mapper's code is in them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from bench.rivals import CELLS_PER_M, SIDE
from terrafuse.kernels.memory import DISTANCE, prefetch
from terrafuse.types import Scan

BLOCK = 2048
RECORD = np.dtype(
    [("n", "<u4"), ("low", "<f4"), ("high", "<f4"), ("sum", "<f4"), ("squares", "<f4"), ("pad", "<f4", 3)]
)


@njit(nogil=True)
def _transform(x, y, z, m, T, where, heights):
    for k in range(m):
        i = (T[0, 0] * x[k] + T[0, 1] * y[k] + T[0, 2] * z[k] + T[0, 3]) * CELLS_PER_M
        j = (T[1, 0] * x[k] + T[1, 1] * y[k] + T[1, 2] * z[k] + T[1, 3]) * CELLS_PER_M
        where[k] = (np.int32(np.floor(j)) + SIDE // 3) * SIDE + np.int32(np.floor(i)) + SIDE // 3
        heights[k] = T[2, 0] * x[k] + T[2, 1] * y[k] + T[2, 2] * z[k] + T[2, 3]


@njit(nogil=True)
def _locate_all(points, T, where, heights):
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for first in range(0, points.shape[0], BLOCK):
        m = min(BLOCK, points.shape[0] - first)
        for k in range(m):
            x[k], y[k], z[k] = points[first + k, 0], points[first + k, 1], points[first + k, 2]
        _transform(x, y, z, m, T, where[first:], heights[first:])


@njit(nogil=True)
def _scatter_all(where, heights, m, records):
    for k in range(m):
        prefetch(records, where[k + DISTANCE])
        record, z = records[np.uint64(where[k])], heights[k]
        record.n += np.uint32(1)
        record.low = min(record.low, z)
        record.high = max(record.high, z)
        record.sum += z
        record.squares += z * z


class Bound:
    """Prepared arrays for both stages."""

    def __init__(self, scans: list[Scan]) -> None:
        most = max(len(scan.points) for scan in scans)
        self._where, self._heights = np.zeros(most + DISTANCE, np.int32), np.empty(most, np.float32)
        self._records = np.zeros(SIDE * SIDE, RECORD)
        self._located = []
        for scan in scans:
            self.locate(scan)
            self._located.append((self._where.copy(), self._heights.copy()))

    def locate(self, scan: Scan) -> None:
        _locate_all(scan.points, scan.T_world_sensor.matrix.astype(np.float32), self._where, self._heights)

    def scatter(self, index: int, scan: Scan) -> None:
        where, heights = self._located[index]
        _scatter_all(where, heights, len(scan.points), self._records)
