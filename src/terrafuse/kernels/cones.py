"""Where a sonar's cone goes: the cells whose centres lie in it, each with its distance and angle.

Only geometry; what an echo says of a cell at that distance and angle is the models' business.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.types import Array

MAX_BAND_CELLS = 500
"""No reading's band reaches further before and behind it: with the length of cones it bounds the memory of a scan."""


def cone_capacity(reach_m: float, cells_per_m: float) -> int:
    """More cells than any cone of this reach has."""
    return (2 * math.ceil(reach_m * cells_per_m) + 3) ** 2


@njit(inline="always")
def clipped(low, high, dy, edge_x, edge_y, side):
    """The part of low to high along a row `dy` off the apex that lies on one side (1 left, -1 right) of an edge."""
    if edge_y * side > 0.0:
        high = min(high, edge_x * dy / edge_y)
    elif edge_y * side < 0.0:
        low = max(low, edge_x * dy / edge_y)
    return low, high


@njit(cache=True, nogil=True)
def cone(x, y, axis_x, axis_y, half_angle, reach, cells_per_m, i, j, rho, theta, first):
    """The cells of a cone with its apex at (x, y) metres and the unit axis (axis_x, axis_y), out to `reach` metres.

    Writes cell indices, distance rho (m) and angle theta from the axis (0 to half_angle, rad) of each from position
    `first` on, in rising (j, i) order; returns the position after the last. The cell that holds the apex is in it.
    """
    cell = 1.0 / cells_per_m
    least, most = math.cos(half_angle), math.sin(half_angle)
    home_i, home_j = np.floor(x * cells_per_m), np.floor(y * cells_per_m)
    # A cone is narrow: only the stretch of a row that lies between its edges, and a cell more, is looked at.
    right_x, right_y = axis_x * least + axis_y * most, axis_y * least - axis_x * most
    left_x, left_y = axis_x * least - axis_y * most, axis_y * least + axis_x * most
    narrow = least > 0.0
    south = -reach if -axis_y >= least or not narrow else reach * min(0.0, right_y, left_y) - cell
    north = reach if axis_y >= least or not narrow else reach * max(0.0, right_y, left_y) + cell
    for b in range(int(np.floor((y + south) * cells_per_m)), int(np.floor((y + north) * cells_per_m)) + 1):
        dy = (b + 0.5) * cell - y
        half_chord2 = reach * reach - dy * dy
        if half_chord2 < 0.0 and b != home_j:
            continue
        half_chord = math.sqrt(max(half_chord2, 0.0))
        west, east = -half_chord, half_chord
        if narrow:
            west, east = clipped(west, east, dy, right_x, right_y, 1.0)
            west, east = clipped(west, east, dy, left_x, left_y, -1.0)
            west, east = west - cell, east + cell
        if b == home_j:
            west, east = min(west, -cell), max(east, cell)
        elif west > east:
            continue
        for a in range(int(np.floor((x + west) * cells_per_m)), int(np.floor((x + east) * cells_per_m)) + 1):
            dx = (a + 0.5) * cell - x
            distance = math.sqrt(dx * dx + dy * dy)
            home = a == home_i and b == home_j
            along = dx * axis_x + dy * axis_y
            if not home and (distance > reach or along < least * distance):
                continue
            i[first], j[first], rho[first] = a, b, distance
            theta[first] = 0.0 if home else math.atan2(abs(axis_x * dy - axis_y * dx), along)
            first += 1
    return first


def cone_reference(
    x: float, y: float, heading_rad: float, half_angle: float, reach: float, cells_per_m: float
) -> dict[tuple[int, int], tuple[float, float]]:
    """What `cone` must equal: (i, j) → (distance, angle off the axis)."""
    around = math.ceil(reach * cells_per_m) + 1
    i0, j0 = math.floor(x * cells_per_m), math.floor(y * cells_per_m)
    b, a = np.mgrid[j0 - around : j0 + around + 1, i0 - around : i0 + around + 1]
    dx, dy = (a + 0.5) / cells_per_m - x, (b + 0.5) / cells_per_m - y
    rho = np.hypot(dx, dy)
    theta: Array = np.abs((np.arctan2(dy, dx) - heading_rad + np.pi) % (2 * np.pi) - np.pi)
    home = (a == i0) & (b == j0)
    theta[home] = 0.0
    inside = home | ((rho <= reach) & (theta <= half_angle))
    return {
        (int(i), int(j)): (float(r), float(t))
        for i, j, r, t in zip(a[inside], b[inside], rho[inside], theta[inside], strict=True)
    }
