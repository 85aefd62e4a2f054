"""A scan's sums → heights, gradients, confidence and occupation of its cells (the *patrol* paper, section 3.3)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.kernels.rasterise import WINDOW, cell_at, place_of
from terrafuse.kernels.terrain import (
    CELL,
    GRADIENT_X,
    GRADIENT_Y,
    GRADIENTS,
    HEIGHT,
    MOST_CONFIDENT,
    OCCUPATION,
    PLANE,
    WALL,
)
from terrafuse.kernels.terrain_rule import occupation_reference, occupy
from terrafuse.types import Array, Floats

COLLINEAR = 2.0
"""Points lie on a line if their standard deviation across it is no more than so many of a point's own standard errors:
then noise alone spreads them so. Points of a wall, a line from above, stay under it but for 1 case in 2000."""
ROUNDING2 = 1e-12
"""Below this variance across, in sides of the cell squared, sums in float64 are mostly rounding."""


class Shape(NamedTuple):
    """What tells planes, walls and loose points apart, metres."""

    sigma_m: float
    """Standard error of a point."""
    wall_m: float
    """Points that reach over more height stand for a wall."""
    loosest_m: float
    """A plane whose height at the cell's centre has a larger standard error is none: it lies beside its points."""


SMALL_RANGE, SMALL_PENALTY = 0.75, 0.2
"""Up to this share of the maximum range the weight falls by the penalty; beyond it, to nothing (fig. 6)."""


@njit(cache=True, nogil=True)
def fit(sums, count, sensor_z, cells_per_m, shape, cells):
    """Heights of `count` cells, and gradients where the points make a plane (eqs. 1 to 7): 3 or more, not on a line.

    How far they are from a line is the smallest eigenvalue λ of the scatter S of their places. It gives the standard
    error of the slope, too, in the direction in which that is largest: σ / √(n·λ). That of the height at the centre, at
    d from their middle, is σ √((1 + dᵀS⁻¹d) / n). Of a wall, the height is that of the highest point.
    """
    sigma = shape.sigma_m * cells_per_m
    least2 = max(COLLINEAR * COLLINEAR * sigma * sigma, ROUNDING2)
    for k in range(count):
        s, cell = sums[k], cells[k]
        one_by_n = 1.0 / s.n  # divisions are most of the work
        u, v, w = s.u * one_by_n, s.v * one_by_n, s.w * one_by_n
        uu, uv, vv = s.uu * one_by_n - u * u, s.uv * one_by_n - u * v, s.vv * one_by_n - v * v
        half = (uu - vv) / 2
        thinnest2 = (uu + vv) / 2 - math.sqrt(half * half + uv * uv)
        a, b, error = 0.0, 0.0, 0.0
        cell.flags = HEIGHT
        if s.high - s.low > shape.wall_m:
            w = s.high
            cell.flags = HEIGHT | WALL
        elif s.n >= 3.0 and thinnest2 > least2:
            one_by_determinant = 1.0 / (uu * vv - uv * uv)
            aside = (u * u * vv - 2.0 * u * v * uv + v * v * uu) * one_by_determinant
            if shape.sigma_m * shape.sigma_m * (1.0 + aside) * one_by_n <= shape.loosest_m * shape.loosest_m:
                uw, vw = s.uw * one_by_n - u * w, s.vw * one_by_n - v * w
                a, b = (uw * vv - vw * uv) * one_by_determinant, (vw * uu - uw * uv) * one_by_determinant
                error = sigma / math.sqrt(s.n * thinnest2)
                cell.flags = HEIGHT | GRADIENTS | PLANE
        cell.height = w - a * u - b * v + sensor_z
        cell.gradient_x = np.float32(a * cells_per_m)
        cell.gradient_y = np.float32(b * cells_per_m)
        cell.gradient_error = np.float32(error)


@njit(inline="always")
def neighbour(a, b, grid, first_slot):
    """The slot of the cell (a, b) of the window; negative where this scan did not hit it."""
    if a < 0 or b < 0 or a >= WINDOW or b >= WINDOW:
        return -1
    return grid[place_of(a, b)] - first_slot


@njit(inline="always")
def difference(below, own, above, sums, cells, cells_per_m):
    """(dz/dx, its variance in σ²/side², whether there is one) from the neighbours on one axis: central, one-sided
    (eqs. 8, 9) or none."""
    if below < 0 and above < 0:
        return np.float32(0.0), 0.0, False
    low, high = below if below >= 0 else own, above if above >= 0 else own
    sides = 2.0 if below >= 0 and above >= 0 else 1.0
    variance = (1.0 / sums[low].n + 1.0 / sums[high].n) / (sides * sides)
    return np.float32((cells[high].height - cells[low].height) * cells_per_m / sides), variance, True


@njit(cache=True, nogil=True)
def difference_neighbours(sums, places, count, grid, first_slot, cells_per_m, point_sigma_m, cells):
    """Gradients of the cells that have no plane, from the heights of their four neighbours.

    Their error is that of the heights, means of so many points each; where in their cells these lie, it leaves out.
    What stands beside a cell says nothing of its slope: `grid` has no walls afterwards.
    """
    sigma = point_sigma_m * cells_per_m
    for k in range(count):
        if cells[k].flags & WALL:
            grid[places[k]] = first_slot - 1
    for k in range(count):
        cell = cells[k]
        if cell.flags & (GRADIENTS | WALL):
            continue
        a, b = cell_at(places[k])
        west, east = neighbour(a - 1, b, grid, first_slot), neighbour(a + 1, b, grid, first_slot)
        south, north = neighbour(a, b - 1, grid, first_slot), neighbour(a, b + 1, grid, first_slot)
        cell.gradient_x, variance_x, has_x = difference(west, k, east, sums, cells, cells_per_m)
        cell.gradient_y, variance_y, has_y = difference(south, k, north, sums, cells, cells_per_m)
        cell.gradient_error = np.float32(sigma * math.sqrt(max(variance_x, variance_y)))
        cell.flags |= (GRADIENT_X if has_x else np.uint16(0)) | (GRADIENT_Y if has_y else np.uint16(0))


@njit(inline="always")
def range_weight(share):
    """At this share of the range: 1 at the sensor, 0.8 at three quarters, 0 at its end (eq. 10, as its text and figure
    have it)."""
    if share <= SMALL_RANGE:
        return 1.0 - SMALL_PENALTY / SMALL_RANGE * share
    return max((1.0 - SMALL_PENALTY) / (1.0 - SMALL_RANGE) * (1.0 - share), 0.0)


@njit(inline="always")
def bits(x):
    """How many bits of a uint64 are set."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, nogil=True)
def assess(sums, places, count, i0, j0, T, cells_per_m, max_range, subcells, cells):
    """Confidence: the share of sub-cells hit, times the weight of the distance to the middle of the points."""
    side, per_subcell, per_range = 1.0 / cells_per_m, 1.0 / subcells, 1.0 / max_range
    for k in range(count):
        s = sums[k]
        a, b = cell_at(places[k])
        one_by_n = 1.0 / s.n
        east = (i0 + a + 0.5 + s.u * one_by_n) * side - T[0, 3]
        north = (j0 + b + 0.5 + s.v * one_by_n) * side - T[1, 3]
        up = s.w * one_by_n
        weight = range_weight(math.sqrt(east * east + north * north + up * up) * per_range)
        cells[k].confidence = min(np.float32(bits(s.hit) * per_subcell * weight), MOST_CONFIDENT)


@njit(cache=True, nogil=True)
def occupy_all(count, max_slope, cells):
    for k in range(count):
        occupy(cells[k], max_slope)


# --- the same, as slowly as it reads ---------------------------------------------------------------------------------


def fit_reference(sums: Array, sensor_z: float, cells_per_m: float, shape: Shape) -> Array:
    """(K,) CELL with height and gradients: β = (XᵀX)⁻¹ XᵀY (eq. 7), with X = [1 u v] and Y = w, where that is sound."""
    n, u, v, w = (sums[name] for name in ("n", "u", "v", "w"))
    spread = np.array([[sums["uu"], sums["uv"]], [sums["uv"], sums["vv"]]]) / n
    spread -= np.array([[u * u, u * v], [u * v, v * v]]) / n**2
    thinnest2 = np.linalg.eigvalsh(spread.transpose(2, 0, 1))[:, 0]
    sigma = shape.sigma_m * cells_per_m
    wall = sums["high"] - sums["low"] > shape.wall_m
    sound = ~wall & (n >= 3) & (thinnest2 > max((COLLINEAR * sigma) ** 2, ROUNDING2))
    middle = np.stack([u, v], axis=-1) / n[:, None]
    inverse = np.linalg.inv(np.where(sound[:, None, None], spread.transpose(2, 0, 1), np.eye(2)))
    aside = np.einsum("ki,kij,kj->k", middle, inverse, middle)
    sound &= shape.sigma_m * np.sqrt((1 + aside) / n) <= shape.loosest_m
    XtX = np.array([[n, u, v], [u, sums["uu"], sums["uv"]], [v, sums["uv"], sums["vv"]]]).transpose(2, 0, 1)
    XtY = np.stack([w, sums["uw"], sums["vw"]], axis=-1)
    beta = np.zeros((len(sums), 3))
    beta[:, 0] = np.where(wall, sums["high"], w / n)
    beta[sound] = np.linalg.solve(XtX[sound], XtY[sound][..., None])[..., 0]
    cells = np.zeros(len(sums), CELL)
    cells["height"] = beta[:, 0] + sensor_z
    cells["gradient_x"], cells["gradient_y"] = (beta[:, axis] * cells_per_m for axis in (1, 2))
    cells["gradient_error"][sound] = sigma / np.sqrt((n * thinnest2)[sound])
    cells["flags"] = np.where(sound, HEIGHT | GRADIENTS | PLANE, np.where(wall, HEIGHT | WALL, HEIGHT))
    return cells


def difference_neighbours_reference(
    i: Array, j: Array, sums: Array, cells: Array, cells_per_m: float, point_sigma_m: float
) -> None:
    """Fill in the gradients of cells (K,) in rising (j, i) order that have no plane."""
    height = np.full((j.max() - j.min() + 3, i.max() - i.min() + 3), np.nan)
    row, column = j - j.min() + 1, i - i.min() + 1
    wall = cells["flags"] & WALL != 0
    height[row, column] = np.where(wall, np.nan, cells["height"])
    variance = np.full(height.shape, np.nan)
    variance[row, column] = np.where(wall, np.nan, (point_sigma_m * cells_per_m) ** 2 / sums["n"])
    bare = cells["flags"] & (GRADIENTS | WALL) == 0
    for name, flag, (dj, di) in (("gradient_x", GRADIENT_X, (0, 1)), ("gradient_y", GRADIENT_Y, (1, 0))):
        below, above = height[row - dj, column - di], height[row + dj, column + di]
        sides = 2.0 - np.isnan(below) - np.isnan(above)
        low, high = (np.where(np.isnan(side), cells["height"], side) for side in (below, above))
        fill = bare & (sides > 0)
        cells[name][fill] = (high - low)[fill] * cells_per_m / sides[fill]
        cells["flags"][fill] |= flag
        below, above = variance[row - dj, column - di], variance[row + dj, column + di]
        low, high = (np.where(np.isnan(side), variance[row, column], side) for side in (below, above))
        error = np.sqrt(low + high)[fill] / sides[fill]
        cells["gradient_error"][fill] = np.maximum(cells["gradient_error"][fill], error)


def range_weight_reference(distance: Floats, max_range: float) -> Floats:
    """The line through (0, 1), (0.75 R, 0.8) and (R, 0)."""
    return np.interp(distance, [0.0, SMALL_RANGE * max_range, max_range], [1.0, 1.0 - SMALL_PENALTY, 0.0])


def assess_reference(
    i: Array, j: Array, sums: Array, T: Floats, cells_per_m: float, max_range: float, subcells: int
) -> Floats:
    """Confidence of each cell, 0 to 1."""
    middle = np.stack(
        [
            (i + 0.5 + sums["u"] / sums["n"]) / cells_per_m - T[0, 3],
            (j + 0.5 + sums["v"] / sums["n"]) / cells_per_m - T[1, 3],
            sums["w"] / sums["n"],
        ]
    )
    weight = range_weight_reference(np.sqrt((middle**2).sum(axis=0)), max_range)
    return np.asarray(np.minimum(np.bitwise_count(sums["hit"]) / subcells * weight, MOST_CONFIDENT))


def occupy_reference(cells: Array, max_slope: float) -> None:
    """Fill in the occupation."""
    east, north = (cells[name].astype(np.float64) for name in ("gradient_x", "gradient_y"))
    error, both = cells["gradient_error"].astype(np.float64), cells["flags"] & GRADIENTS == GRADIENTS
    wall = cells["flags"] & WALL != 0
    cells["occupation"], known = occupation_reference(east, north, error, both, wall, max_slope)
    cells["flags"][known] |= OCCUPATION
