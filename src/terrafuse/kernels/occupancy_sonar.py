"""What a sonar's reading says of the cells in its cone.

Elfes, "Using occupancy grids for mobile robot perception and navigation" (1989), after Moravec & Elfes, "High
resolution maps from wide angle sonar" (1985): evidence of empty E_r(δ)·E_a(θ) before the echo, evidence of occupied
O_r(δ)·O_a(θ) about it, for a cell at distance δ and angle θ off the axis.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.kernels.cones import cone, cone_capacity
from terrafuse.kernels.occupancy import READING, TICKS_PER_NAT
from terrafuse.types import Array, Beam, Floats

MAX_CONE_CELLS = 512
"""No cone is longer: 51 m at 0.1 m, 13 m at one inch. It bounds time and memory, whatever a scan says."""


@njit(inline="always")
def empty_range(delta, reading, error, nearest):
    """E_r = 1 - ((δ - R_min)/(r - ε - R_min))² from R_min to r - ε; 0 elsewhere, where nothing is said of empty."""
    if delta < nearest or delta >= reading - error:
        return 0.0
    return 1.0 - ((delta - nearest) / (reading - error - nearest)) ** 2


@njit(inline="always")
def occupied_range(delta, reading, error):
    """O_r = 1 - ((δ - r)/ε)² within ε of r; 0 elsewhere."""
    if abs(delta - reading) > error:
        return 0.0
    return 1.0 - ((delta - reading) / error) ** 2


@njit(inline="always")
def off_axis(theta, half_angle):
    """E_a = O_a = 1 - (θ/ω)²."""
    return max(0.0, 1.0 - (theta / half_angle) ** 2)


@njit(inline="always")
def ticks_of(evidence):
    """Log-odds of p = ½(1 + evidence), -1 < evidence < 1: ln((1 + e)/(1 - e)) in ticks."""
    return np.int64(np.rint(math.log((1.0 + evidence) / (1.0 - evidence)) * TICKS_PER_NAT))


@njit(cache=True, nogil=True)
def evidence(delta, theta, reading, echo, half_angle, error, nearest, most_empty, most_occupied):
    """Evidence of a cell, > 0 for occupied and < 0 for empty, within -most_empty to most_occupied.

    `echo` is whether there was one: without, the reading clears and marks nothing.
    """
    across = off_axis(theta, half_angle)
    empty = empty_range(delta, reading, error, nearest) * across
    if empty > 0.0:
        return -min(empty, most_empty)
    return min(occupied_range(delta, reading, error) * across, most_occupied) if echo else 0.0


@njit(cache=True, nogil=True)
def listen(
    ends, echoes, half_angle, error, nearest, most_empty, most_occupied, reliability, cells_per_m, i0, j0, width,
    slots, near, i, j, readings,
):  # fmt: skip
    """Sum what all cones say of each cell. Returns how many cells any says something of.

    ends (K, 4) x0 y0 x1 y1 in metres, echoes (K,) bool. `slots` int32, all -1 and so again afterwards, covers the
    window of cells from (i0, j0); `near` = (i, j, rho, theta) is scratch for one cone; cells go to i, j, readings.
    """
    near_i, near_j, rho, theta = near
    count = 0
    for k in range(ends.shape[0]):
        x, y = ends[k, 0], ends[k, 1]
        reading = math.hypot(ends[k, 2] - x, ends[k, 3] - y)
        if reading == 0.0:  # straight up or down
            continue
        axis_x, axis_y = (ends[k, 2] - x) / reading, (ends[k, 3] - y) / reading
        reach = reading + error if echoes[k] else reading
        cells = cone(x, y, axis_x, axis_y, half_angle, reach, cells_per_m, near_i, near_j, rho, theta, 0)
        for c in range(cells):
            said = evidence(rho[c], theta[c], reading, echoes[k], half_angle, error, nearest, most_empty, most_occupied)
            ticks = ticks_of(said * reliability)
            if ticks == 0:
                continue
            place = (near_j[c] - j0) * width + (near_i[c] - i0)
            slot = slots[place]
            if slot < 0:
                slot = count
                slots[place] = slot
                i[slot], j[slot] = near_i[c], near_j[c]
                readings[slot].ticks, readings[slot].updates = 0, 0
                count += 1
            readings[slot].ticks += ticks
            readings[slot].updates += np.uint32(1)
    for c in range(count):
        slots[(j[c] - j0) * width + (i[c] - i0)] = -1
    return count


class Listener:
    """The cones of one robot's scans; keeps the scratch between them."""

    def __init__(self, cells_per_m: float, most_empty: float, most_occupied: float) -> None:
        self._cells_per_m = cells_per_m
        self._most = most_empty, most_occupied
        self._slots = np.full(1 << 14, -1, np.int32)
        self._near = _room_for_a_cone(1 << 12)

    def __call__(self, ends: Floats, echoes: Array, beam: Beam, nearest_m: float) -> tuple[Array, Array, Array]:
        """Readings from ends (K, 4) x0 y0 x1 y1 in metres, echoes (K,) bool → distinct cells i, j, and what they hear.

        ε is the beam's range error, but no less than half a cell: a narrower band would mostly have no cell's centre
        in it. Each reading is evidence of its own and adds, as in Elfes' updates, reading by reading: a ring that fires
        in one scan and one that fires in sixteen make the same map.
        """
        if not len(ends):
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, READING)
        error = max(beam.range_error_m, 0.5 / self._cells_per_m)
        reach = float(np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]).max()) + error
        i0, j0, width, height = self._window(ends, reach)
        cone_cells = cone_capacity(reach, self._cells_per_m)
        if len(self._slots) < width * height:
            self._slots = np.full(width * height, -1, np.int32)
        if len(self._near[0]) < cone_cells:
            self._near = _room_for_a_cone(cone_cells)
        most = min(width * height, len(ends) * cone_cells)
        i, j, readings = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, READING)
        count = listen(
            ends, echoes, beam.half_angle_rad, error, nearest_m, *self._most, beam.reliability, self._cells_per_m,
            i0, j0, width, self._slots, self._near, i, j, readings,
        )  # fmt: skip
        return i[:count], j[:count], readings[:count]

    def _window(self, ends: Floats, reach: float) -> tuple[int, int, int, int]:
        """(i0, j0, width, height) of the cells that cones of this reach can meet."""
        low = np.floor((ends[:, :2].min(axis=0) - reach) * self._cells_per_m).astype(np.int64) - 1
        high = np.floor((ends[:, :2].max(axis=0) + reach) * self._cells_per_m).astype(np.int64) + 1
        return int(low[0]), int(low[1]), int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1


def _room_for_a_cone(cells: int) -> tuple[Array, Array, Floats, Floats]:
    return np.empty(cells, np.int64), np.empty(cells, np.int64), np.empty(cells), np.empty(cells)
